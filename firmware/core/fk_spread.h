/* How sure the track is: variances of pose and speed at all its instants, how fixes shrink and strokes widen them.
 *
 * One for x and y together, one for the heading. A stroke gives the robot what the table says and a kick beside it;
 * how large kicks are is learned while swimming, so that a poor model is believed less.
 */
#ifndef FK_SPREAD_H
#define FK_SPREAD_H

#include <stdint.h>

#include "fk_profile.h"

#define FK_INSTANTS 4u      /* at which the track keeps states */
#define FK_TRACK_STATES 8u  /* 2 i: pose at instant i, 2 i + 1: speed there */

/* Numbers of one kind of axis. Variances, in m^2 and (m/s)^2 or rad^2 and (rad/s)^2. */
typedef struct {
    float fix;        /* of a fix */
    float shape;      /* of fk_profile.h, times doubt^2 */
    float gate;       /* added to a fix's at the gate */
    float kick;       /* of the kick to begin with, at the least, at the most */
    float kick_least;
    float kick_most;
    float pose;       /* of a pose and a speed of which nothing is known */
    float speed;
} fk_noise_t;

typedef struct {
    const fk_noise_t *noise;
    float covariance[FK_TRACK_STATES][FK_TRACK_STATES]; /* symmetric */
    float kick;              /* variance of the speed that a stroke gives beside the table's word */
    float foretold_variance; /* of the newest instant's pose, as its period began */
} fk_spread_t;

/* How one measured pose bears on all states. */
typedef struct {
    float cross[FK_TRACK_STATES]; /* covariance of each with the pose there */
    float variance;               /* of measured minus expected */
} fk_bearing_t;

extern const fk_noise_t fk_noise_position;
extern const fk_noise_t fk_noise_heading;

void fk_spread_init(fk_spread_t *spread, const fk_noise_t *noise);

/* Nothing is known of instant 0. */
void fk_spread_unknown(fk_spread_t *spread);

/* Instant from + 1, period_s later. resting: 1 = no limb fires in between. */
void fk_spread_foretell(fk_spread_t *spread, uint32_t from, float period_s, int32_t resting);

/* The bearing of a pose measured in the period that begins at instant `from`, in which `fixes` were before.
 * states: 2 x instants. Returns the largest square of measured minus expected that the gate lets through. */
float fk_spread_bearing(const fk_spread_t *spread, const fk_profile_t *profile, uint32_t from, uint32_t states,
                        uint32_t fixes, fk_bearing_t *bearing);

/* Take that pose. The caller moves the means by cross x (measured - expected) / variance. */
void fk_spread_correct(fk_spread_t *spread, const fk_bearing_t *bearing, uint32_t states);

/* The newest instant, newest > 0, becomes the one that the profile says of the period before it. */
void fk_spread_move(fk_spread_t *spread, const fk_profile_t *profile, uint32_t newest);

/* Instant 0 goes, the others move up; `left` remain. */
void fk_spread_drop(fk_spread_t *spread, uint32_t left);

/* The robot was not where the track had it: kicks may be larger than was learned. */
void fk_spread_doubt(fk_spread_t *spread);

/* A period ended: its pose, on `axes` axes, came out by square (summed) from what was foretold. part: how much this
 * one period counts. */
void fk_spread_learn(fk_spread_t *spread, uint32_t newest, float square, float axes, float part);

#endif
