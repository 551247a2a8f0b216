/* Online estimate of what each limb has lost of its contribution.
 *
 * The prediction error of each period is regressed on the wear curves of the limbs that fired in it, and on a
 * current. This is recursive least squares with exponential forgetting (Ljung 1999, System Identification, section
 * 11.2): the normal equations of all periods are summed, and the weight of a period fades. Limbs and current enter by
 * forward selection, as long as one more explains more than its penalty. If no limb is worn, none is selected, and
 * the planner decides as without this estimate. Whether a worn limb has lost everything is then decided by single
 * periods.
 *
 *   unknowns     a current in the world frame (m/s, m/s, rad/s), then the lost share of each limb (0 to 1)
 *   rows         derivatives of a period's forward, left (m) and turn (rad) in the body frame at its start
 *   information  sum of rows^T rows over the variance of the error; vector: sum of rows^T error over it
 *
 * The Python twin is host/frogkick/estimator/wear.py; both give the same bits.
 */
#ifndef FK_WEAR_H
#define FK_WEAR_H

#include <stdint.h>

#include "fk_frames_layout.h"
#include "fk_tables.h"

#define FK_WEAR_UNKNOWNS (3u + FK_LIMBS_MAX)
#define FK_WEAR_GONE 26214u /* lost share (0.8 of FK_LOST_MAX) from which a limb counts as lost */
#define FK_WEAR_SUMS (FK_WEAR_UNKNOWNS * (FK_WEAR_UNKNOWNS + 1u) / 2u)

typedef struct {
    float information[FK_WEAR_SUMS];   /* lower triangle, row by row */
    float vector[FK_WEAR_UNKNOWNS];
    float current[3];                  /* estimated current */
    uint16_t lost[FK_LIMBS_MAX];       /* estimated lost shares: 0 = nothing to FK_LOST_MAX = all */
    int16_t shift[6u * FK_ACTIONS_MAX]; /* how they change each action: fk_tables_t's `worn` points here */
    uint8_t learn;                     /* FK_LEARN_... */
} fk_wear_t;

/* A period that has ended. */
typedef struct {
    float error[3];    /* pose at its end minus the predicted one, with limbs as worn as estimated: x m, y m, heading rad, world */
    float variance[2]; /* of that pose, given the fixes: of x and of y m^2, of the heading rad^2 */
    float heading_rad; /* heading at its start, less than a turn from zero */
    float period_s;
    uint8_t action;
} fk_wear_period_t;

/* Start with nothing lost. learn: FK_LEARN_..., which stays OFF for tables without wear curves. */
void fk_wear_init(fk_wear_t *wear, fk_tables_t *tables, uint8_t learn);

/* Start again from the present shares, each with a standard deviation of a quarter of it, and no current. The sums
 * over earlier periods are dropped, because nobody knows how long ago these were. */
void fk_wear_restart(fk_wear_t *wear);

/* Update the estimate by a period, and the tables by the estimate. */
void fk_wear_learn(fk_wear_t *wear, fk_tables_t *tables, const fk_wear_period_t *period);

/* 1 where a limb is estimated to have lost FK_WEAR_GONE of its contribution, else 0. */
int32_t fk_wear_lacks_a_limb(const fk_wear_t *wear);

/* Make the tables predict with limbs as worn as `lost` says. */
void fk_wear_use(fk_wear_t *wear, fk_tables_t *tables);

#endif
