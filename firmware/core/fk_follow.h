/* How far along its path the robot is, and whether the run is over. The Python twin is
 * host/frogkick/estimator/follow.py; both give the same bits.
 */
#ifndef FK_FOLLOW_H
#define FK_FOLLOW_H

#include <stdint.h>

#include "fk_planner.h"

#define FK_FOLLOW_ON 1               /* the run goes on; every other value is an ENDED status */
#define FK_IDLE_DECISIONS_MAX 40u    /* without progress or approach by a quarter of the longest stroke: stalled */
#define FK_IDLE_LACKING_MAX 20u      /* the same of a robot that lacks a limb */

typedef struct {
    float along_points;    /* where along the path the robot was at the last decision; 0 at the start */
    float mark_points;     /* the same when progress or approach last counted */
    float mark_x_m;        /* that place of the path, world */
    float mark_y_m;
    float mark_distance_m; /* the robot's distance from it */
    uint32_t idle;         /* decisions since */
    uint8_t begun;         /* a decision was made */
} fk_follow_t;

void fk_follow_begin(fk_follow_t *follow);

/* Another path is followed from here on. The robot goes on where it is nearest to it; where several of its stretches are as
 * near, at the first of these: a path that closes or crosses itself is not cut short. As near: the squares of the distances
 * differ by that of a longest stroke at most.
 * @param x_m, y_m  the robot's place, world
 */
void fk_follow_change(fk_follow_t *follow, const fk_tables_t *tables, const fk_path_t *path, float x_m, float y_m);

/* After a decision with a plan.
 * @param lacks_a_limb  not 0: one of the robot's limbs is believed to be lost, see fk_wear_lacks_a_limb()
 * @retval FK_FOLLOW_ON       goes on
 * @retval FK_STATUS_OK       the path's end is reached
 * @retval FK_STATUS_PASSED   the end is passed, more than one longest stroke beside it (cost route)
 * @retval FK_STATUS_STALLED  neither progress nor approach for FK_IDLE_DECISIONS_MAX decisions, or for
 *                            FK_IDLE_LACKING_MAX where it lacks a limb
 */
int32_t fk_follow_decided(fk_follow_t *follow, const fk_tables_t *tables, const fk_path_t *path,
                          const fk_plan_config_t *config, const fk_plan_t *plan, int32_t lacks_a_limb);

/* Between decisions, at a fix: with the cost route a run ends where the robot crosses the path's end, not up to a
 * period later.
 * @retval FK_FOLLOW_ON, FK_STATUS_OK, FK_STATUS_PASSED
 */
int32_t fk_follow_fixed(const fk_follow_t *follow, const fk_tables_t *tables, const fk_path_t *path,
                        const fk_plan_config_t *config, float x_m, float y_m);

#endif
