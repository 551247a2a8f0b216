/* cost.c - what it costs to be at a pose: the paper's Eq. 19 as its authors' runs logged it. */
#include "fk_internal.h"

float fk_cost(const fk_path_t *path, const fk_plan_config_t *config, float x_m, float y_m, float heading_rad)
{
    float distance2_m2;
    const uint32_t index = fk_path_nearest(path, x_m, y_m, &distance2_m2);
    const float angle_rad = fk_wrap_angle(heading_rad - path->tangent_rad[index]);
    const float angle_size_rad = (angle_rad < 0.0f) ? -angle_rad : angle_rad;
    const float progress = (float)index / (float)(path->count - 1U); /* count >= 2, checked */
    const float distance_cost = config->distance_weight_per_m * FK_SQRT(distance2_m2);
    const float angle_cost = config->angle_weight_per_rad * angle_size_rad;
    const float progress_cost = config->progress_weight * (1.0f - progress);

    return (distance_cost + angle_cost) + progress_cost;
}
