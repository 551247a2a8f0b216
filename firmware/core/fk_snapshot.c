/* The state that decisions and strokes depend on, as bytes. One traversal (walk_...) both writes and reads it.
 *
 * It leaves out the table, counters, frames under way, and whatever is written before it is read again. Numbers are
 * little-endian, floats by their bits. host/frogkick/runs/chip_twin.py reads the same format.
 */
#include "fk_robot_state.h"

#define PART_BYTES 240u

/* More than the content of any snapshot: these structures with their padding, and what walk_robot_state() itself
 * names. */
#define CONTENT_BYTES                                                                                          \
    (2u * sizeof(fk_path_t) + sizeof(fk_plan_config_t) + sizeof(fk_follow_t) + sizeof(fk_estimator_t) +         \
     sizeof(fk_guard_t) + 64u)
#define HEADS_BYTES ((CONTENT_BYTES / PART_BYTES + 1u) * (FK_LOG_HEAD_BYTES + FK_SNAPSHOT_RECORD_BYTES))
typedef char fk_snapshot_fits[(CONTENT_BYTES + HEADS_BYTES <= FK_LOG_SNAPSHOT_MAX_BYTES) ? 1 : -1];

typedef struct {
    fk_robot_t *robot;
    const uint8_t *from; /* 0: the state is written to the robot's log; else it is read from here */
    uint32_t left;
    int32_t wrong;       /* 1: what was read is not a state */
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

/* A value above `most` is wrong and becomes 0, so that no count or index of a damaged snapshot leaves its array. */
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

static void walk_plan(fk_walk_t *walk, fk_plan_config_t *config)
{
#define WALK(name, NAME, least, most) f32(walk, &config->name, 1u);
    FK_PLAN_WEIGHTS(WALK)
    u32(walk, &config->transitions_max);
    u8(walk, &config->cost, FK_COST_LAST);
    u8(walk, &config->depth, FK_DEPTH_MAX);
}

static void walk_path(fk_walk_t *walk, fk_path_t *path, uint8_t *points, uint8_t *total)
{
    u8(walk, total, FK_PATH_POINTS_MAX);
    u8(walk, points, *total);
    /* A path is whole when the points received are all of them. */
    path->count = (*points == *total) ? *total : 0u;
    f32(walk, path->x_m, *points);
    f32(walk, path->y_m, *points);
    f32(walk, path->tangent_rad, *points);
}

static void walk_follow(fk_walk_t *walk, fk_follow_t *follow)
{
    f32(walk, &follow->along_points, 1u);
    f32(walk, &follow->mark_points, 1u);
    f32(walk, &follow->mark_x_m, 1u);
    f32(walk, &follow->mark_y_m, 1u);
    f32(walk, &follow->mark_distance_m, 1u);
    u32(walk, &follow->idle);
    u8(walk, &follow->begun, 1u);
}

static void walk_covariance(fk_walk_t *walk, fk_covariance_t *covariance, uint32_t states)
{
    f32(walk, &covariance->process_noise, 1u);
    f32(walk, &covariance->predicted_variance, 1u);
    for (uint32_t i = 0u; i < states; ++i) {
        f32(walk, covariance->matrix[i], states);
    }
}

static void walk_wear(fk_walk_t *walk, fk_wear_t *wear, fk_tables_t *tables)
{
    const uint32_t unknowns = 3u + tables->limbs;
    u8(walk, &wear->learn, (tables->wear_knots > 0u) ? FK_LEARN_HELD : FK_LEARN_OFF);
    if (walk->from != 0) {
        fk_wear_init(wear, tables, wear->learn);
    }
    if (wear->learn == FK_LEARN_OFF) {
        return; /* nothing was learned */
    }
    f32(walk, wear->information, unknowns * (unknowns + 1u) / 2u);
    f32(walk, wear->vector, unknowns);
    f32(walk, wear->current, 3u);
    for (uint32_t limb = 0u; limb < tables->limbs; ++limb) {
        u16(walk, &wear->lost[limb]);
        if (wear->lost[limb] > FK_LOST_MAX) {
            walk->wrong = 1;
            wear->lost[limb] = 0u;
        }
    }
    fk_wear_use(wear, tables);
}

static void walk_track(fk_walk_t *walk, fk_track_t *track)
{
    const uint32_t actions = track->tables->actions; /* also the one for rest that has no row */
    u8(walk, &track->learned, 3u);
    u8(walk, &track->prediction_valid, 1u);
    u8(walk, &track->count, FK_INSTANTS);
    walk_wear(walk, &track->wear, track->tables);
    f32(walk, track->predicted, 3u);
    walk_covariance(walk, &track->covariance[0], 2u * track->count);
    walk_covariance(walk, &track->covariance[1], 2u * track->count);
    for (uint32_t axis = 0u; axis < 3u; ++axis) {
        f32(walk, track->mean[axis], 2u * track->count);
    }
    for (uint32_t i = 0u; i < track->count; ++i) {
        u64(walk, &track->time_us[i]);
        for (uint32_t limb = 0u; limb < FK_LIMBS_MAX; ++limb) {
            u16(walk, &track->limb_use[i][limb]);
        }
        if (i + 1u < track->count) { /* the newest instant's period has not begun */
            u8(walk, &track->action[i], actions);
            u8(walk, &track->coasted[i], 1u);
            u8(walk, &track->fixes[i], UINT8_MAX);
        }
    }
}

static void walk_estimator(fk_walk_t *walk, fk_estimator_t *estimator)
{
    walk_track(walk, &estimator->track);
    u64(walk, &estimator->action_us);
    u8(walk, &estimator->action, estimator->track.tables->actions);
    u8(walk, &estimator->action_waits, 1u);
    u64(walk, &estimator->newest_us);
    u16(walk, &estimator->newest_sequence);
    u8(walk, &estimator->fixes, UINT8_MAX);
    u8(walk, &estimator->outlier_count, FK_OUTLIERS_MAX - 1u);
    for (uint32_t i = 0u; i < estimator->outlier_count; ++i) {
        u64(walk, &estimator->outliers[i].capture_us);
        f32(walk, estimator->outliers[i].pose, 3u);
        u16(walk, &estimator->outliers[i].sequence);
    }
    u8(walk, &estimator->next_mark, FK_FIX_MARKS - 1u);
    for (uint32_t i = 0u; i < FK_FIX_MARKS; ++i) {
        u32(walk, &estimator->marks[i]);
    }
}

static void walk_guard(fk_walk_t *walk, fk_guard_t *guard, uint32_t limbs)
{
    uint8_t closed_loop = (uint8_t)guard->closed_loop;
    u64(walk, &guard->fix_us);
    u8(walk, &closed_loop, 1u);
    guard->closed_loop = closed_loop;
    for (uint32_t limb = 0u; limb < limbs; ++limb) {
        fk_guard_limb_t *one = &guard->limbs[limb];
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

static void walk_robot_state(fk_walk_t *walk)
{
    fk_robot_t *robot = walk->robot;
    u64(walk, &robot->now_us);
    u8(walk, &robot->state, FK_STATE_RUNNING); /* no snapshot is taken in FAULT */
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
    walk_plan(walk, &robot->plan);
    walk_path(walk, &robot->path, &robot->path_points, &robot->path_total);
    walk_path(walk, &robot->coming, &robot->coming_points, &robot->coming_total);
    walk_follow(walk, &robot->follow);
    walk_estimator(walk, &robot->estimator);
    walk_guard(walk, &robot->guard, robot->tables.limbs);
}

void fk_robot_log_snapshot(fk_robot_t *robot)
{
    fk_walk_t walk = {robot, 0, 0u, 0, 0u, {0u}, {0u, 0u, robot->log_broken, robot->tables.image_crc32}};
    walk_robot_state(&walk);
    walk.part.last = 1u;
    write_part(&walk);
    robot->log_broken = 0u;
    robot->log_mark = robot->log->end;
}

int32_t fk_robot_restore(fk_robot_t *robot, const uint8_t *snapshot, uint32_t length)
{
    fk_walk_t walk = {robot, snapshot, length, 0, 0u, {0u}, {0u, 0u, 0u, 0u}};
    walk_robot_state(&walk);
    fk_guard_seal(&robot->guard);
    robot->log_broken = 0u;
    robot->log_mark = robot->log->end;
    robot->replays = 1u;
    return (walk.wrong == 0 && walk.left == 0u) ? 0 : -1;
}
