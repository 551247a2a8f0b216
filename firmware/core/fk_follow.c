#include "fk_follow.h"

#include "fk_frames_layout.h"

#define FAR2_M2 1.0e9f       /* positions are within 1000 m of the origin, so squares of distances stay below 1e7 */
#define FK_FOLLOW_GAIN 0.25f /* part of the longest stroke that counts as progress or approach */

void fk_follow_begin(fk_follow_t *follow)
{
    follow->along_points = 0.0f;
    follow->mark_points = 0.0f;
    follow->mark_x_m = 0.0f;
    follow->mark_y_m = 0.0f;
    follow->mark_distance_m = 0.0f;
    follow->idle = 0u;
    follow->begun = 0u;
}

/* Project a position onto a segment: how far along it, 0 to 1, and the squared distance. */
static float nearest_part(const fk_path_t *path, uint32_t segment, float x_m, float y_m, float *distance2_m2)
{
    const float dx_m = path->x_m[segment + 1u] - path->x_m[segment];
    const float dy_m = path->y_m[segment + 1u] - path->y_m[segment];
    const float length2_m2 = dx_m * dx_m + dy_m * dy_m;
    const float along_m2 = (x_m - path->x_m[segment]) * dx_m + (y_m - path->y_m[segment]) * dy_m;
    float part = 0.0f;
    if (along_m2 >= length2_m2) { /* so nothing is divided by 0 */
        part = 1.0f;
    } else if (along_m2 > 0.0f) {
        part = along_m2 / length2_m2;
    }
    const float across_x_m = (x_m - path->x_m[segment]) - part * dx_m;
    const float across_y_m = (y_m - path->y_m[segment]) - part * dy_m;
    *distance2_m2 = across_x_m * across_x_m + across_y_m * across_y_m;
    return part;
}

void fk_follow_change(fk_follow_t *follow, const fk_tables_t *tables, const fk_path_t *path, float x_m, float y_m)
{
    float distance2_m2;
    float least2_m2 = FAR2_M2;
    fk_follow_begin(follow);
    for (uint32_t segment = 0u; segment + 1u < path->count; ++segment) {
        (void)nearest_part(path, segment, x_m, y_m, &distance2_m2);
        least2_m2 = (distance2_m2 < least2_m2) ? distance2_m2 : least2_m2;
    }
    const float near2_m2 = least2_m2 + tables->stroke_max_m * tables->stroke_max_m;
    float best2_m2 = FAR2_M2; /* of the first stretch that is as near as that */
    for (uint32_t segment = 0u; segment + 1u < path->count; ++segment) {
        const float part = nearest_part(path, segment, x_m, y_m, &distance2_m2);
        if (distance2_m2 > near2_m2) {
            if (best2_m2 < FAR2_M2) {
                break;
            }
        } else if (distance2_m2 < best2_m2) {
            best2_m2 = distance2_m2;
            follow->along_points = (float)segment + part;
        }
    }
}

static int32_t end_status(const fk_tables_t *tables, float distance_m)
{
    return (distance_m <= tables->stroke_max_m) ? FK_STATUS_OK : FK_STATUS_PASSED;
}

/* Set the mark anew if the robot has made progress since the last one, else count an idle decision. */
static void mark_progress(fk_follow_t *follow, const fk_tables_t *tables, const fk_path_t *path, float distance_m)
{
    uint32_t last = path->count - 2u;
    uint32_t segment = (uint32_t)follow->along_points;
    segment = (segment > last) ? last : segment;
    float part = follow->along_points - (float)segment;
    float x_m = path->x_m[segment] + part * (path->x_m[segment + 1u] - path->x_m[segment]);
    float y_m = path->y_m[segment] + part * (path->y_m[segment + 1u] - path->y_m[segment]);
    float dx_m = x_m - follow->mark_x_m;
    float dy_m = y_m - follow->mark_y_m;
    float gain_m = FK_FOLLOW_GAIN * tables->stroke_max_m;
    int32_t is_further = follow->along_points > follow->mark_points && dx_m * dx_m + dy_m * dy_m >= gain_m * gain_m;
    int32_t is_nearer = distance_m <= follow->mark_distance_m - gain_m;
    if (follow->begun != 0u && !is_further && !is_nearer) {
        ++follow->idle;
        return;
    }
    follow->mark_points = follow->along_points;
    follow->mark_x_m = x_m;
    follow->mark_y_m = y_m;
    follow->mark_distance_m = distance_m;
    follow->idle = 0u;
    follow->begun = 1u;
}

int32_t fk_follow_decided(fk_follow_t *follow, const fk_tables_t *tables, const fk_path_t *path,
                          const fk_plan_config_t *config, const fk_plan_t *plan, int32_t lacks_a_limb)
{
    const uint32_t idle_max = (lacks_a_limb != 0) ? FK_IDLE_LACKING_MAX : FK_IDLE_DECISIONS_MAX;
    follow->along_points = plan->along_points;
    mark_progress(follow, tables, path, plan->distance_m);
    if (plan->path_index + 1u >= path->count) {
        return (config->cost == FK_COST_ROUTE) ? end_status(tables, plan->distance_m) : FK_STATUS_OK;
    }
    return (follow->idle >= idle_max) ? FK_STATUS_STALLED : FK_FOLLOW_ON;
}

int32_t fk_follow_fixed(const fk_follow_t *follow, const fk_tables_t *tables, const fk_path_t *path,
                        const fk_plan_config_t *config, float x_m, float y_m)
{
    if (follow->begun == 0u || config->cost != FK_COST_ROUTE) {
        return FK_FOLLOW_ON;
    }
    float distance_m;
    float along_points = fk_path_along(tables, path, follow->along_points, x_m, y_m, &distance_m);
    return (along_points >= (float)(path->count - 1u)) ? end_status(tables, distance_m) : FK_FOLLOW_ON;
}
