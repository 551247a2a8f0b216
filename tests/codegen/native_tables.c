/* native_tables.c - flat-array entries to the table look-up for a host that binds them without its structures.
 * Part of a shared library of the host only, never of an emitted directory. */
#include "fk_internal.h"
#include "native_inputs.h"

FK_EXPORT int32_t fk_native_lookup(const uint8_t *image, uint32_t size, const int32_t *codes,
                                   const uint16_t *use, const uint16_t *lost, uint32_t count, uint32_t *rows,
                                   float *motions, int32_t *next_codes, uint16_t *next_use);
FK_EXPORT int32_t fk_native_nearest(const uint8_t *image, uint32_t size, const int32_t *codes, uint32_t count,
                                    uint32_t *rows);
FK_EXPORT int32_t fk_native_bounds(const uint8_t *image, uint32_t size, float *bounds);
FK_EXPORT int32_t fk_native_robot(const uint8_t *image, uint32_t size, const char *robot_id);
FK_EXPORT int32_t fk_native_action(const uint8_t *image, uint32_t size, uint8_t index, uint8_t *row);
FK_EXPORT int32_t fk_native_nulls(const uint8_t *image, uint32_t size, int32_t *statuses);
FK_EXPORT void fk_native_codes(const float *velocities, uint32_t count, float codes_per_velocity,
                               int32_t *codes);

static void fk_native_dynamics(const int32_t *codes, const uint16_t *use, fk_dynamics_t *dynamics)
{
    uint32_t index;

    for (index = 0U; index < 3U; index++) {
        dynamics->velocity_code[index] = codes[index];
    }
    for (index = 0U; index < FK_LIMBS_MAX; index++) {
        dynamics->limb_use[index] = (use == 0) ? (uint16_t)0U : use[index];
    }
}

/* codes: count x 3; use: count x FK_LIMBS_MAX; lost: FK_LIMBS_MAX, or null. rows: count; motions: count x actions x 3; next_codes: count x
 * actions x 3; next_use: count x actions x FK_LIMBS_MAX. Returns what fk_tables_open() returns. */
int32_t fk_native_lookup(const uint8_t *image, uint32_t size, const int32_t *codes, const uint16_t *use,
                         const uint16_t *lost, uint32_t count, uint32_t *rows, float *motions, int32_t *next_codes,
                         uint16_t *next_use)
{
    fk_tables_t tables;
    int16_t shift[6U * FK_ACTIONS_MAX];
    uint32_t index;
    const int32_t error = fk_native_open_worn(image, size, lost, shift, &tables);

    if (error != FK_OK) {
        return error;
    }
    for (index = 0U; index < count; index++) {
        fk_dynamics_t from;
        fk_lookup_t lookup;
        uint32_t action;
        fk_native_dynamics(codes + 3U * index, use + FK_LIMBS_MAX * index, &from);
        fk_lookup(&tables, &from, &lookup);
        rows[index] = lookup.row;
        for (action = 0U; action < tables.actions; action++) {
            const uint32_t at = tables.actions * index + action;
            fk_motion_t motion;
            fk_dynamics_t next;
            uint32_t value;
            fk_lookup_motion(&tables, &lookup, &from, action, &motion);
            fk_lookup_next(&tables, &lookup, &from, action, &next);
            motions[3U * at] = motion.forward_m;
            motions[3U * at + 1U] = motion.left_m;
            motions[3U * at + 2U] = motion.turn_rad;
            for (value = 0U; value < 3U; value++) {
                next_codes[3U * at + value] = next.velocity_code[value];
            }
            for (value = 0U; value < FK_LIMBS_MAX; value++) {
                next_use[FK_LIMBS_MAX * at + value] = next.limb_use[value];
            }
        }
    }
    return FK_OK;
}

/* rows: of count velocities. Returns what fk_tables_open() returns. */
int32_t fk_native_nearest(const uint8_t *image, uint32_t size, const int32_t *codes, uint32_t count,
                          uint32_t *rows)
{
    fk_tables_t tables;
    uint32_t index;
    const int32_t error = fk_tables_open(image, size, &tables);

    if (error != FK_OK) {
        return error;
    }
    for (index = 0U; index < count; index++) {
        rows[index] = fk_nearest(&tables, codes + 3U * index);
    }
    return FK_OK;
}

/* bounds: stroke_max_m, turn_max_rad. Returns what fk_tables_open() returns. */
int32_t fk_native_bounds(const uint8_t *image, uint32_t size, float *bounds)
{
    fk_tables_t tables;
    const int32_t error = fk_tables_open(image, size, &tables);

    if (error == FK_OK) {
        bounds[0] = tables.stroke_max_m;
        bounds[1] = tables.turn_max_rad;
    }
    return error;
}

int32_t fk_native_robot(const uint8_t *image, uint32_t size, const char *robot_id)
{
    fk_tables_t tables;
    const int32_t error = fk_tables_open(image, size, &tables);

    return (error != FK_OK) ? error : fk_tables_check_robot(&tables, robot_id);
}

/* row: name, first mask, second mask. */
int32_t fk_native_action(const uint8_t *image, uint32_t size, uint8_t index, uint8_t *row)
{
    fk_tables_t tables;
    fk_action_t action;
    int32_t error = fk_tables_open(image, size, &tables);

    if (error == FK_OK) {
        error = fk_tables_action(&tables, index, &action);
    }
    if (error == FK_OK) {
        row[0] = (uint8_t)action.name;
        row[1] = action.first_mask;
        row[2] = action.second_mask;
    }
    return error;
}

/* statuses: 6, of calls that each lack one argument. */
int32_t fk_native_nulls(const uint8_t *image, uint32_t size, int32_t *statuses)
{
    fk_tables_t tables;
    fk_action_t action;
    const int32_t error = fk_tables_open(image, size, &tables);

    statuses[0] = fk_tables_open(0, size, &tables);
    statuses[1] = fk_tables_open(image, size, 0);
    statuses[2] = fk_tables_check_robot(0, "robot");
    statuses[3] = fk_tables_check_robot(&tables, 0);
    statuses[4] = fk_tables_action(0, 0U, &action);
    statuses[5] = fk_tables_action(&tables, 0U, 0);
    return error;
}

void fk_native_codes(const float *velocities, uint32_t count, float codes_per_velocity, int32_t *codes)
{
    uint32_t index;

    for (index = 0U; index < count; index++) {
        codes[index] = fk_velocity_code(velocities[index], codes_per_velocity);
    }
}
