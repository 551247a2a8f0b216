/* The covariance of the Kalman filter in fk_track.h: one matrix for x and for y, one for the heading. F, Q, H, R and the gate
 * are named there. Q is learned while swimming (adaptive process noise), so that a poor model is believed less.
 */
#ifndef FK_COVARIANCE_H
#define FK_COVARIANCE_H

#include <stdint.h>

#include "fk_profile.h"

#define FK_INSTANTS 4u      /* at which the track keeps states */
#define FK_TRACK_STATES 8u  /* 2 i: pose at instant i, 2 i + 1: speed there */

/* Numbers of one kind of axis. Variances, in m^2 and (m/s)^2 or rad^2 and (rad/s)^2. */
typedef struct {
    float fix;           /* of a fix */
    float shape;         /* of fk_profile.h, times doubt^2 */
    float gate;          /* added to a fix's at the gate */
    float process_noise; /* of a stroke's speed: to begin with, at the least, at the most */
    float process_noise_least;
    float process_noise_most;
    float pose; /* of a pose and a speed of which nothing is known */
    float speed;
} fk_noise_t;

typedef struct {
    const fk_noise_t *noise;
    float matrix[FK_TRACK_STATES][FK_TRACK_STATES]; /* symmetric */
    float process_noise;      /* variance of the speed that a stroke gives beside what the table says */
    float predicted_variance; /* of the newest instant's pose, as its period began */
} fk_covariance_t;

/* What a measured pose says of all states. */
typedef struct {
    float cross[FK_TRACK_STATES]; /* covariance of each with the pose there */
    float variance;               /* of measured minus expected */
} fk_innovation_t;

extern const fk_noise_t fk_noise_position;
extern const fk_noise_t fk_noise_heading;

void fk_covariance_init(fk_covariance_t *covariance, const fk_noise_t *noise);

/* Nothing is known of instant 0. */
void fk_covariance_reset(fk_covariance_t *covariance);

/* Instant from + 1, period_s later. resting: 1 = no limb fires in between. */
void fk_covariance_predict(fk_covariance_t *covariance, uint32_t from, float period_s, int32_t resting);

/* The variance of the innovation of a pose measured in the period that begins at instant `from`, in which `fixes` were
 * before, and its covariance with each state. states: 2 x instants. Returns the largest square of measured minus expected that the gate lets through. */
float fk_covariance_innovation(const fk_covariance_t *covariance, const fk_profile_t *profile, uint32_t from, uint32_t states,
                        uint32_t fixes, fk_innovation_t *innovation);

/* Take that pose. The caller moves the means by cross x (measured - expected) / variance. */
void fk_covariance_update(fk_covariance_t *covariance, const fk_innovation_t *innovation, uint32_t states);

/* The newest instant, newest > 0, becomes the one that the profile says of the period before it. */
void fk_covariance_retime(fk_covariance_t *covariance, const fk_profile_t *profile, uint32_t newest);

/* Instant 0 goes, the others move up; `left` remain. */
void fk_covariance_marginalise(fk_covariance_t *covariance, uint32_t left);

/* The robot was not where the track had it: the process noise may be larger than was learned. */
void fk_covariance_inflate(fk_covariance_t *covariance);

/* The variance of the newest instant's pose, where fixes told at least half of what its prediction left open; below 0: they
 * did not. */
float fk_covariance_told(const fk_covariance_t *covariance, uint32_t newest);

/* A period ended: its pose, on `axes` axes, came out by square (summed) from what was predicted. part: how much this
 * one period counts. */
void fk_covariance_adapt(fk_covariance_t *covariance, uint32_t newest, float square, float axes, float part);

#endif
