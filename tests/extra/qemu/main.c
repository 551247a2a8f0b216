/* Plans the test's states with the emitted table and prints each decision's bits as hexadecimal words, in
 * the order of the twin's PLAN_ROW. Floats come in and go out as bits: nothing is rounded on the way. */
#include <stdint.h>

#include "cases.h"
#include "fk_planner.h"
#include "fk_table.h"
#include "startup.h"

#define ROW_WORDS 23u

int main(void);

static float float_of(uint32_t bits)
{
    union {
        uint32_t bits;
        float value;
    } both;
    both.bits = bits;
    return both.value;
}

static uint32_t bits_of(float value)
{
    union {
        uint32_t bits;
        float value;
    } both;
    both.value = value;
    return both.bits;
}

static void plan_case(const fk_tables_t *tables, const fk_path_t *path, fk_plan_config_t *config, uint32_t index)
{
    const uint32_t *words = fk_case_states[index];
    fk_state_t state = {float_of(words[0]), float_of(words[1]), float_of(words[2]), float_of(words[3]),
                        float_of(words[4]), float_of(words[5]), {0u}, float_of(words[6])};
    uint32_t row[ROW_WORDS] = {0u};
    fk_plan_t plan;

    for (uint32_t limb = 0u; limb < FK_LIMBS_MAX; ++limb) {
        state.limb_use[limb] = fk_case_limb_use[index][limb];
    }
    config->depth = fk_case_depths[index];
    const int32_t status = fk_plan(tables, path, config, &state, &plan);
    row[0] = (uint32_t)status;
    if (status == FK_OK) {
        row[1] = plan.action;
        row[2] = plan.nearest_state;
        row[3] = plan.path_index;
        row[4] = plan.depth_reached;
        row[5] = plan.transitions;
        row[6] = bits_of(plan.cost);
        row[7] = bits_of(plan.distance_m);
        row[8] = bits_of(plan.along_points);
        row[9] = bits_of(plan.predicted.x_m);
        row[10] = bits_of(plan.predicted.y_m);
        row[11] = bits_of(plan.predicted.heading_rad);
        row[12] = bits_of(plan.predicted.vx_mps);
        row[13] = bits_of(plan.predicted.vy_mps);
        row[14] = bits_of(plan.predicted.omega_rad_s);
        for (uint32_t limb = 0u; limb < FK_LIMBS_MAX; ++limb) {
            row[15u + limb] = plan.predicted.limb_use[limb];
        }
    }
    for (uint32_t word = 0u; word < ROW_WORDS; ++word) {
        fk_put_word(row[word], (word + 1u == ROW_WORDS) ? '\n' : ' ');
    }
}

int main(void)
{
    static fk_tables_t tables;
    static fk_path_t path;
    fk_plan_config_t config = {
        .transitions_max = FK_CASE_TRANSITIONS_MAX,
        .cost = FK_CASE_COST,
        .depth = 1u,
    };
    const uint32_t *weight = fk_case_weights;
    const int32_t error = fk_tables_open(fk_table_image, fk_table_image_bytes, &tables);

#define TAKE(name, NAME, least, most) config.name = float_of(*weight++);
    FK_PLAN_WEIGHTS(TAKE)
    if (error != FK_OK) {
        fk_put_text("refused ");
        fk_put_word((uint32_t)error, '\n');
        return 1;
    }
    path.count = FK_CASE_POINTS;
    for (uint32_t point = 0u; point < FK_CASE_POINTS; ++point) {
        path.x_m[point] = float_of(fk_case_path[0][point]);
        path.y_m[point] = float_of(fk_case_path[1][point]);
        path.tangent_rad[point] = float_of(fk_case_path[2][point]);
    }
    for (uint32_t index = 0u; index < FK_CASES; ++index) {
        plan_case(&tables, &path, &config, index);
    }
    fk_put_text("done\n");
    return 0;
}
