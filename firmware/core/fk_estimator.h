/* The state at a decision's time, from late position fixes: a straight line through the last few of them.
 * The Python twin is host/frogkick/planner/estimator.py; both give the same bits.
 */
#ifndef FK_ESTIMATOR_H
#define FK_ESTIMATOR_H

#include <stdint.h>

#include "fk_planner.h"

#define FK_FIXES_MAX 8u              /* kept; at 15 Hz the window holds 4 of them, at 30 Hz 8 */
#define FK_FIX_WINDOW_US 250000      /* a fix older than the newest by more does not count: the stroke was another */
#define FK_FIX_STALE_US 500000       /* newest fix older than this at the decision: no estimate */
#define FK_FIX_FUTURE_US 100000      /* newest fix later than the decision by more: no estimate */
#define FK_FIX_FIELD_M 1000.0f       /* positions beyond are refused */

typedef struct {
    uint64_t capture_us; /* robot's clock */
    float x_m;           /* world */
    float y_m;           /* world */
    float heading_rad;   /* world; any turn, wrapped here */
    uint16_t sequence;
} fk_fix_t;

typedef struct {
    fk_fix_t fixes[FK_FIXES_MAX]; /* by capture time, oldest first */
    uint8_t count;
} fk_estimator_t;

typedef struct {
    fk_state_t state;      /* at the asked time; velocity in the body frame */
    uint16_t fix_sequence; /* newest fix used */
    uint8_t fixes;         /* fixes used: 1 = velocity unknown and taken as zero */
} fk_estimate_t;

void fk_estimator_init(fk_estimator_t *estimator);

/* Take a fix.
 * @retval 0         taken
 * @retval negative  FK_STATUS_RANGE: not finite, far outside, or not newer than the newest
 */
int32_t fk_estimator_add(fk_estimator_t *estimator, const fk_fix_t *fix);

/* Estimate at a time.
 * @retval 0         estimate filled
 * @retval negative  FK_STATUS_STALE: no fix near enough to at_us
 */
int32_t fk_estimator_at(const fk_estimator_t *estimator, uint64_t at_us, fk_estimate_t *estimate);

#endif
