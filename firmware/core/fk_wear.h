/* What each limb has lost of its contribution, learned while the robot swims.
 *
 * What a period missed is held against the wear curves of the limbs that fired in it and against a current: recursive
 * least squares with exponential forgetting (Ljung 1999, System Identification, section 11.2). A limb, or the current, is
 * believed where it explains more than its penalty, one after another (forward selection): where nothing is worn, nothing
 * is learned, and every decision is what it would be without.
 *
 *   unknowns  a current in the world frame (m/s, m/s, rad/s), then the lost share of each limb (0 to 1)
 *   rows      forward, left and turn of a period in the body frame at its start
 *   sums      of rows^T rows and rows^T missed, over the variance of what was missed; older ones fade
 */
#ifndef FK_WEAR_H
#define FK_WEAR_H

#include <stdint.h>

#include "fk_frames_layout.h"
#include "fk_tables.h"

#define FK_WEAR_UNKNOWNS (3u + FK_LIMBS_MAX)
#define FK_WEAR_GONE 26214u /* share (0.8, of FK_LOST_MAX) */
#define FK_WEAR_SUMS (FK_WEAR_UNKNOWNS * (FK_WEAR_UNKNOWNS + 1u) / 2u)

typedef struct {
    float information[FK_WEAR_SUMS];   /* lower triangle, row by row */
    float vector[FK_WEAR_UNKNOWNS];
    float current[3];                  /* as believed */
    uint16_t lost[FK_LIMBS_MAX];       /* as believed: 0 = nothing to FK_LOST_MAX = all */
    int16_t shift[6u * FK_ACTIONS_MAX]; /* what that changes of each action: fk_tables_t's `worn` */
    uint8_t learn;                     /* FK_LEARN_... */
} fk_wear_t;

/* A period that has ended. */
typedef struct {
    float missed[3];   /* its end minus where it was predicted, which is with what limbs are believed to have lost: x, y m,
                          heading rad, world frame */
    float variance[2]; /* of that end as the fixes tell it: of x and of y m^2, of the heading rad^2 */
    float heading_rad; /* where the robot headed as it began, within a turn of zero */
    float period_s;
    uint8_t action;
} fk_wear_period_t;

/* Nothing was learned yet. learn: FK_LEARN_... Tables without wear curves are never learned with. */
void fk_wear_init(fk_wear_t *wear, fk_tables_t *tables, uint8_t learn);

/* Of what was learned only the shares remain, each known to a quarter of itself (one standard deviation), and no current.
 * What periods told of them is dropped: nobody knows how long ago that was. */
void fk_wear_restart(fk_wear_t *wear);

/* Learn from a period, and have the tables tell what these limbs do. */
void fk_wear_learn(fk_wear_t *wear, fk_tables_t *tables, const fk_wear_period_t *period);

/* 1 where a limb is believed to be lost: to have lost FK_WEAR_GONE of its contribution. */
int32_t fk_wear_lacks_a_limb(const fk_wear_t *wear);

/* Have the tables tell what limbs do that have lost what `lost` says. */
void fk_wear_use(fk_wear_t *wear, fk_tables_t *tables);

#endif
