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
    float along_points;    /* position along the path at the last decision, in points; 0 at the start */
    float mark_points;     /* the same at the last decision that made progress */
    float mark_x_m;        /* that point of the path, world */
    float mark_y_m;
    float mark_distance_m; /* the robot's distance from it */
    uint32_t idle;         /* decisions since then */
    uint8_t begun;         /* 1: a decision was made */
} fk_follow_t;

void fk_follow_begin(fk_follow_t *follow);

/* Follow another path from now on, from its point nearest to the robot. Where several stretches of the path are
 * equally near, the first of them counts, so that a path that closes or crosses itself is not cut short. Equally
 * near: the squares of the distances differ by at most that of the longest stroke.
 * @param x_m, y_m  the robot's position, world
 */
void fk_follow_change(fk_follow_t *follow, const fk_tables_t *tables, const fk_path_t *path, float x_m, float y_m);

/* After a decision with a plan.
 * @param lacks_a_limb  fk_wear_lacks_a_limb(): not 0 where a limb is estimated to be lost
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
