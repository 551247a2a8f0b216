/* The whole state that decisions and strokes depend on, as bytes: one walk over it writes or reads them.
 *
 * Not in it: what the table says, counters, frames on their way, and what is written before it is read again. Numbers
 * are little-endian, floats by their bits. host/frogkick/runs/chip_twin.py reads the same.
 */
#include "fk_robot_state.h"

#define PART_BYTES 240u

typedef struct {
    fk_robot_t *robot;
    const uint8_t *from; /* 0: the robot's state is written to its log, else read from here */
    uint32_t left;
    int32_t wrong;       /* what was read is no state */
    uint32_t filled;
    uint8_t content[FK_SNAPSHOT_RECORD_BYTES + PART_BYTES];
    fk_snapshot_record_t part;
} fk_walk_t;

static void write_part(fk_walk_t *walk)
{
    fk_snapshot_record_pack(walk->content, &walk->part);
    (void)fk_log_write(walk->robot->log, FK_RECORD_SNAPSHOT, walk->robot->now_us, walk->content,
                       FK_SNAPSHOT_RECORD_BYTES + walk->filled);
    ++walk->part.part;
    walk->filled = 0u;
}

static void bytes(fk_walk_t *walk, uint8_t *values, uint32_t count)
{
    for (uint32_t i = 0u; i < count; ++i) {
        if (walk->from == 0) {
            if (walk->filled == PART_BYTES) {
                write_part(walk);
            }
            walk->content[FK_SNAPSHOT_RECORD_BYTES + walk->filled] = values[i];
            ++walk->filled;
        } else if (walk->left == 0u) {
            walk->wrong = 1;
            values[i] = 0u;
        } else {
            values[i] = *walk->from;
            ++walk->from;
            --walk->left;
        }
    }
}

/* most: what is read beyond is wrong, so that no count or index of a damaged state leaves its array. */
static void u8(fk_walk_t *walk, uint8_t *value, uint32_t most)
{
    bytes(walk, value, 1u);
    if (*value > most) {
        walk->wrong = 1;
        *value = 0u;
    }
}

static void u16(fk_walk_t *walk, uint16_t *value)
{
    uint8_t raw[2];
    fk_put_u16(raw, *value);
    bytes(walk, raw, sizeof(raw));
    *value = fk_get_u16(raw);
}

static void u32(fk_walk_t *walk, uint32_t *value)
{
    uint8_t raw[4];
    fk_put_u32(raw, *value);
    bytes(walk, raw, sizeof(raw));
    *value = fk_get_u32(raw);
}

static void u64(fk_walk_t *walk, uint64_t *value)
{
    uint32_t low = (uint32_t)(*value & 0xFFFFFFFFu);
    uint32_t high = (uint32_t)(*value >> 32);
    u32(walk, &low);
    u32(walk, &high);
    *value = ((uint64_t)high << 32) | low;
}

static void f32(fk_walk_t *walk, float *values, uint32_t count)
{
    for (uint32_t i = 0u; i < count; ++i) {
        fk_f32_bits_t pun;
        pun.value = values[i];
        u32(walk, &pun.bits);
        values[i] = pun.value;
    }
}

static void plan(fk_walk_t *walk, fk_plan_config_t *config)
{
#define WALK(name, NAME, least, most) f32(walk, &config->name, 1u);
    FK_PLAN_WEIGHTS(WALK)
    u32(walk, &config->transitions_max);
    u8(walk, &config->cost, FK_COST_LAST);
    u8(walk, &config->depth, FK_DEPTH_MAX);
}

static void path(fk_walk_t *walk, fk_path_t *told, uint8_t *points, uint8_t *total)
{
    u8(walk, total, FK_PATH_POINTS_MAX);
    u8(walk, points, *total);
    /* A path is whole when the points received are all of them. */
    told->count = (*points == *total) ? *total : 0u;
    f32(walk, told->x_m, *points);
    f32(walk, told->y_m, *points);
    f32(walk, told->tangent_rad, *points);
}

static void follow(fk_walk_t *walk, fk_follow_t *told)
{
    f32(walk, &told->along_points, 1u);
    f32(walk, &told->mark_points, 1u);
    f32(walk, &told->mark_x_m, 1u);
    f32(walk, &told->mark_y_m, 1u);
    f32(walk, &told->mark_distance_m, 1u);
    u32(walk, &told->idle);
    u8(walk, &told->begun, 1u);
}

static void covariance(fk_walk_t *walk, fk_covariance_t *told, uint32_t states)
{
    f32(walk, &told->process_noise, 1u);
    f32(walk, &told->predicted_variance, 1u);
    for (uint32_t i = 0u; i < states; ++i) {
        f32(walk, told->matrix[i], states);
    }
}

static void wear(fk_walk_t *walk, fk_wear_t *told, fk_tables_t *tables)
{
    const uint32_t unknowns = 3u + tables->limbs;
    u8(walk, &told->learn, (tables->wear_knots > 0u) ? FK_LEARN_HELD : FK_LEARN_OFF);
    if (walk->from != 0) {
        fk_wear_init(told, tables, told->learn);
    }
    if (told->learn == FK_LEARN_OFF) {
        return; /* nothing was learned */
    }
    f32(walk, told->information, unknowns * (unknowns + 1u) / 2u);
    f32(walk, told->vector, unknowns);
    f32(walk, told->current, 3u);
    for (uint32_t limb = 0u; limb < tables->limbs; ++limb) {
        u16(walk, &told->lost[limb]);
        if (told->lost[limb] > FK_LOST_MAX) {
            walk->wrong = 1;
            told->lost[limb] = 0u;
        }
    }
    fk_wear_use(told, tables);
}

static void track(fk_walk_t *walk, fk_track_t *told)
{
    const uint32_t actions = told->tables->actions; /* also the one for rest that has no row */
    u8(walk, &told->learned, 3u);
    u8(walk, &told->teaches, 1u);
    u8(walk, &told->count, FK_INSTANTS);
    wear(walk, &told->wear, told->tables);
    f32(walk, told->predicted, 3u);
    covariance(walk, &told->covariance[0], 2u * told->count);
    covariance(walk, &told->covariance[1], 2u * told->count);
    for (uint32_t axis = 0u; axis < 3u; ++axis) {
        f32(walk, told->mean[axis], 2u * told->count);
    }
    for (uint32_t i = 0u; i < told->count; ++i) {
        u64(walk, &told->time_us[i]);
        for (uint32_t limb = 0u; limb < FK_LIMBS_MAX; ++limb) {
            u16(walk, &told->limb_use[i][limb]);
        }
        if (i + 1u < told->count) { /* the newest instant's period has not begun */
            u8(walk, &told->action[i], actions);
            u8(walk, &told->coasted[i], 1u);
            u8(walk, &told->fixes[i], UINT8_MAX);
        }
    }
}

static void estimator(fk_walk_t *walk, fk_estimator_t *told)
{
    track(walk, &told->track);
    u64(walk, &told->action_us);
    u8(walk, &told->action, told->track.tables->actions);
    u8(walk, &told->action_waits, 1u);
    u64(walk, &told->newest_us);
    u16(walk, &told->newest_sequence);
    u8(walk, &told->fixes, UINT8_MAX);
    u8(walk, &told->outlier_count, FK_OUTLIERS_MAX - 1u);
    for (uint32_t i = 0u; i < told->outlier_count; ++i) {
        u64(walk, &told->outliers[i].capture_us);
        f32(walk, told->outliers[i].pose, 3u);
        u16(walk, &told->outliers[i].sequence);
    }
    u8(walk, &told->next_mark, FK_FIX_MARKS - 1u);
    for (uint32_t i = 0u; i < FK_FIX_MARKS; ++i) {
        u32(walk, &told->marks[i]);
    }
}

static void guard(fk_walk_t *walk, fk_guard_t *told, uint32_t limbs)
{
    uint8_t closed_loop = (uint8_t)told->closed_loop;
    u64(walk, &told->fix_us);
    u8(walk, &closed_loop, 1u);
    told->closed_loop = closed_loop;
    for (uint32_t limb = 0u; limb < limbs; ++limb) {
        fk_guard_limb_t *one = &told->limbs[limb];
        uint8_t next = (uint8_t)one->next;
        uint8_t was_cut = (uint8_t)one->was_cut;
        u8(walk, &next, FK_GUARD_HISTORY - 1u);
        one->next = next;
        u64(walk, &one->off_us);
        u8(walk, &was_cut, 1u);
        one->was_cut = was_cut;
        for (uint32_t i = 0u; i < FK_GUARD_HISTORY; ++i) {
            u64(walk, &one->start_us[i]);
            u32(walk, &one->on_us[i]);
        }
    }
}

static void robot_state(fk_walk_t *walk)
{
    fk_robot_t *robot = walk->robot;
    u64(walk, &robot->now_us);
    u8(walk, &robot->state, FK_STATE_RUNNING); /* there is none of a robot in FAULT */
    u32(walk, &robot->period_us);
    u32(walk, &robot->decisions);
    u64(walk, &robot->next_decision_us);
    u8(walk, &robot->stroke_request, robot->tables.actions + 1u);
    u64(walk, &robot->stroke_us);
    u8(walk, &robot->second_mask, UINT8_MAX);
    u64(walk, &robot->second_us);
    u64(walk, &robot->free_us);
    u8(walk, &robot->all_off, 1u);
    u8(walk, &robot->supply, FK_SUPPLY_LOW);
    plan(walk, &robot->plan);
    path(walk, &robot->path, &robot->path_points, &robot->path_total);
    path(walk, &robot->coming, &robot->coming_points, &robot->coming_total);
    follow(walk, &robot->follow);
    estimator(walk, &robot->estimator);
    guard(walk, &robot->guard, robot->tables.limbs);
}

void fk_robot_log_snapshot(fk_robot_t *robot)
{
    fk_walk_t walk = {robot, 0, 0u, 0, 0u, {0u}, {0u, 0u, robot->log_broken, robot->tables.image_crc32}};
    robot_state(&walk);
    walk.part.last = 1u;
    write_part(&walk);
    robot->log_broken = 0u;
    robot->log_mark = robot->log->end;
}

int32_t fk_robot_restore(fk_robot_t *robot, const uint8_t *snapshot, uint32_t length)
{
    fk_walk_t walk = {robot, snapshot, length, 0, 0u, {0u}, {0u, 0u, 0u, 0u}};
    robot_state(&walk);
    fk_guard_seal(&robot->guard);
    robot->log_broken = 0u;
    robot->log_mark = robot->log->end;
    robot->replays = 1u;
    return (walk.wrong == 0 && walk.left == 0u) ? 0 : -1;
}
