/* The state that decisions and strokes depend on, as bytes. One traversal (walk_...) both writes and reads it.
 *
 * It leaves out the table, counters, frames under way, and whatever is written before it is read again. Of matrices that
 * are symmetric it has the lower triangle, and of the guard's history the pulses that still count. Numbers are
 * little-endian, floats by their bits. host/frogkick/runs/chip_twin.py reads the same format.
 *
 * To write it changes nothing of the robot: what is damaged stays so, and is found by whoever checks it. A snapshot that
 * is read may be damaged itself, or made by anybody: whatever becomes a count, an index or a divisor is checked first.
 */
#include "fk_robot_state.h"

#define PART_BYTES 240u

/* More than the content of any snapshot: these structures with their padding, the bytes of two paths and of the guard,
 * and what walk_robot_state() itself names. */
#define PATH_BYTES (2u + 12u * FK_PATH_POINTS_MAX)
#define GUARD_BYTES (9u + FK_LIMBS_MAX * (10u + 8u * FK_GUARD_HISTORY))
#define HALVES_BYTES (4u * FK_TRACK_STATES * (FK_TRACK_STATES - 1u)) /* upper triangles of two matrices of 4 bytes each */
#define CONTENT_BYTES                                                                                          \
    (2u * PATH_BYTES + sizeof(fk_plan_config_t) + sizeof(fk_follow_t) + sizeof(fk_estimator_t) - HALVES_BYTES + \
     GUARD_BYTES + 64u)
#define HEADS_BYTES ((CONTENT_BYTES / PART_BYTES + 1u) * (FK_LOG_HEAD_BYTES + FK_SNAPSHOT_RECORD_BYTES))
typedef char fk_snapshot_fits[(CONTENT_BYTES + HEADS_BYTES <= FK_LOG_SNAPSHOT_MAX_BYTES) ? 1 : -1];

typedef struct {
    const fk_robot_t *robot;
    fk_robot_t *to;      /* 0: the state is written to the robot's log; else it is read from here into the same robot */
    const uint8_t *from;
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

static void write_byte(fk_walk_t *walk, uint8_t byte)
{
    if (walk->filled == PART_BYTES) {
        write_part(walk);
    }
    walk->content[FK_SNAPSHOT_RECORD_BYTES + walk->filled] = byte;
    ++walk->filled;
}

static uint8_t read_byte(fk_walk_t *walk)
{
    if (walk->left == 0u) {
        walk->wrong = 1;
        return 0u;
    }
    --walk->left;
    return *walk->from++;
}

/* Write the lowest `bytes` bytes of a number, which is returned; or return the number that is read. */
static uint32_t number(fk_walk_t *walk, uint32_t value, uint32_t bytes)
{
    uint8_t raw[4] = {0u};
    if (walk->to == 0) {
        fk_put_u32(raw, value);
        for (uint32_t i = 0u; i < bytes; ++i) {
            write_byte(walk, raw[i]);
        }
        return value;
    }
    for (uint32_t i = 0u; i < bytes; ++i) {
        raw[i] = read_byte(walk);
    }
    return fk_get_u32(raw);
}

/* The same, of 1 byte. What is read and is not least to most is wrong and becomes `least`, so that no count or index of a
 * damaged snapshot leaves its array. */
static uint32_t number_within(fk_walk_t *walk, uint32_t value, uint32_t least, uint32_t most)
{
    const uint32_t got = number(walk, value, 1u);
    if (walk->to != 0 && (got < least || got > most)) {
        walk->wrong = 1;
        return least;
    }
    return got;
}

static uint64_t number_of_time(fk_walk_t *walk, uint64_t time_us)
{
    const uint32_t low = number(walk, (uint32_t)(time_us & 0xFFFFFFFFu), 4u);
    return ((uint64_t)number(walk, (uint32_t)(time_us >> 32), 4u) << 32) | low;
}

/* Where a field of the robot is read to. */
static void *place(const fk_walk_t *walk, const void *field)
{
    return (uint8_t *)walk->to + ((const uint8_t *)field - (const uint8_t *)walk->robot);
}

static void u8(fk_walk_t *walk, const uint8_t *field, uint32_t least, uint32_t most)
{
    const uint32_t value = number_within(walk, *field, least, most);
    if (walk->to != 0) {
        *(uint8_t *)place(walk, field) = (uint8_t)value;
    }
}

static void u16(fk_walk_t *walk, const uint16_t *field, uint32_t most)
{
    const uint32_t value = number(walk, *field, 2u);
    if (walk->to != 0) {
        walk->wrong |= (value > most) ? 1 : 0;
        *(uint16_t *)place(walk, field) = (uint16_t)((value > most) ? 0u : value);
    }
}

static void u32(fk_walk_t *walk, const uint32_t *field)
{
    const uint32_t value = number(walk, *field, 4u);
    if (walk->to != 0) {
        *(uint32_t *)place(walk, field) = value;
    }
}

static void u64(fk_walk_t *walk, const uint64_t *field)
{
    const uint64_t value = number_of_time(walk, *field);
    if (walk->to != 0) {
        *(uint64_t *)place(walk, field) = value;
    }
}

static void f32(fk_walk_t *walk, const float *fields, uint32_t count)
{
    for (uint32_t i = 0u; i < count; ++i) {
        fk_f32_bits_t pun;
        pun.value = fields[i];
        pun.bits = number(walk, pun.bits, 4u);
        if (walk->to != 0) {
            *(float *)place(walk, &fields[i]) = pun.value;
        }
    }
}

/* What is read and is not within becomes 0. */
static void f32_within(fk_walk_t *walk, const float *fields, uint32_t count, float least, float most)
{
    f32(walk, fields, count);
    for (uint32_t i = 0u; walk->to != 0 && i < count; ++i) {
        if (!(fields[i] >= least && fields[i] <= most)) { /* NaN is not */
            walk->wrong = 1;
            *(float *)place(walk, &fields[i]) = 0.0f;
        }
    }
}

static void walk_plan(fk_walk_t *walk, const fk_plan_config_t *config)
{
#define WALK(name, NAME, least, most) f32_within(walk, &config->name, 1u, least, most);
    FK_PLAN_WEIGHTS(WALK)
    u32(walk, &config->transitions_max);
    u8(walk, &config->cost, 0u, FK_COST_LAST);
    u8(walk, &config->depth, 1u, FK_DEPTH_MAX);
}

static void walk_path(fk_walk_t *walk, const fk_path_t *path, const uint8_t *points, const uint8_t *total)
{
    u8(walk, total, 0u, FK_PATH_POINTS_MAX);
    u8(walk, points, 0u, *total);
    if (walk->to != 0) {
        walk->wrong |= (*total == 1u) ? 1 : 0;
        /* A path is whole when the points received are all of them. */
        *(uint16_t *)place(walk, &path->count) = (*points == *total && *total > 1u) ? *total : 0u;
    }
    f32_within(walk, path->x_m, *points, -FK_POSITION_MAX_M, FK_POSITION_MAX_M);
    f32_within(walk, path->y_m, *points, -FK_POSITION_MAX_M, FK_POSITION_MAX_M);
    f32_within(walk, path->tangent_rad, *points, -FK_HEADING_MAX_RAD, FK_HEADING_MAX_RAD);
}

static void walk_follow(fk_walk_t *walk, const fk_follow_t *follow)
{
    f32_within(walk, &follow->along_points, 1u, 0.0f, (float)(FK_PATH_POINTS_MAX - 1u));
    f32(walk, &follow->mark_points, 1u);
    f32(walk, &follow->mark_x_m, 1u);
    f32(walk, &follow->mark_y_m, 1u);
    f32(walk, &follow->mark_distance_m, 1u);
    u32(walk, &follow->idle);
    u8(walk, &follow->begun, 0u, 1u);
}

static void walk_covariance(fk_walk_t *walk, const fk_covariance_t *covariance, uint32_t states)
{
    f32(walk, &covariance->process_noise, 1u);
    f32(walk, &covariance->predicted_variance, 1u);
    for (uint32_t i = 0u; i < states; ++i) {
        f32(walk, covariance->matrix[i], i + 1u);
        for (uint32_t j = 0u; walk->to != 0 && j < i; ++j) {
            *(float *)place(walk, &covariance->matrix[j][i]) = covariance->matrix[i][j];
        }
    }
}

static void walk_wear(fk_walk_t *walk, const fk_wear_t *wear, const fk_tables_t *tables)
{
    const uint32_t unknowns = 3u + tables->limbs;
    u8(walk, &wear->learn, FK_LEARN_OFF, (tables->wear_knots > 0u) ? FK_LEARN_HELD : FK_LEARN_OFF);
    if (walk->to != 0) {
        fk_wear_init(place(walk, wear), place(walk, tables), wear->learn);
    }
    if (wear->learn == FK_LEARN_OFF) {
        return; /* nothing was learned */
    }
    f32(walk, wear->information, unknowns * (unknowns + 1u) / 2u);
    f32(walk, wear->vector, unknowns);
    f32(walk, wear->current, 3u);
    for (uint32_t limb = 0u; limb < tables->limbs; ++limb) {
        u16(walk, &wear->lost[limb], FK_LOST_MAX);
    }
    if (walk->to != 0) {
        fk_wear_use(place(walk, wear), place(walk, tables));
    }
}

static void walk_track(fk_walk_t *walk, const fk_track_t *track)
{
    const fk_tables_t *tables = &walk->robot->tables;
    u8(walk, &track->learned, 0u, 3u);
    u8(walk, &track->prediction_valid, 0u, 1u);
    u8(walk, &track->count, 0u, FK_INSTANTS);
    walk->wrong |= (track->count == 1u) ? 1 : 0; /* a period has two ends */
    walk_wear(walk, &track->wear, tables);
    f32(walk, track->predicted, 3u);
    walk_covariance(walk, &track->covariance[0], 2u * track->count);
    walk_covariance(walk, &track->covariance[1], 2u * track->count);
    for (uint32_t axis = 0u; axis < 3u; ++axis) {
        f32(walk, track->mean[axis], 2u * track->count);
    }
    for (uint32_t i = 0u; i < track->count; ++i) {
        u64(walk, &track->time_us[i]);
        walk->wrong |= (i > 0u && track->time_us[i] <= track->time_us[i - 1u]) ? 1 : 0;
        for (uint32_t limb = 0u; limb < FK_LIMBS_MAX; ++limb) {
            u16(walk, &track->limb_use[i][limb], FK_LIMB_USE_MAX);
        }
        if (i + 1u < track->count) { /* the newest instant's period has not begun */
            u8(walk, &track->action[i], 0u, tables->actions); /* also the one for rest that has no row */
            u8(walk, &track->coasted[i], 0u, 1u);
            u8(walk, &track->fixes[i], 0u, UINT8_MAX);
        }
    }
}

static void walk_estimator(fk_walk_t *walk, const fk_estimator_t *estimator)
{
    walk_track(walk, &estimator->track);
    u64(walk, &estimator->action_us);
    u8(walk, &estimator->action, 0u, walk->robot->tables.actions);
    u8(walk, &estimator->action_waits, 0u, 1u);
    u64(walk, &estimator->newest_us);
    u16(walk, &estimator->newest_sequence, UINT16_MAX);
    u8(walk, &estimator->fixes, 0u, UINT8_MAX);
    u8(walk, &estimator->outlier_count, 0u, FK_OUTLIERS_MAX - 1u);
    for (uint32_t i = 0u; i < estimator->outlier_count; ++i) {
        u64(walk, &estimator->outliers[i].capture_us);
        f32(walk, estimator->outliers[i].pose, 3u);
        u16(walk, &estimator->outliers[i].sequence, UINT16_MAX);
    }
    u8(walk, &estimator->next_mark, 0u, FK_FIX_MARKS - 1u);
    for (uint32_t i = 0u; i < FK_FIX_MARKS; ++i) {
        u32(walk, &estimator->marks[i]);
    }
}

/* The latest pulses, oldest first, as long ago as each began. They are read to the entries from 0 on. */
static void walk_pulses(fk_walk_t *walk, const fk_guard_limb_t *limb)
{
    const uint64_t now_us = walk->robot->now_us;
    fk_guard_limb_t *to = (walk->to != 0) ? place(walk, limb) : 0;
    const uint32_t count = number_within(walk, fk_guard_remembered(limb, now_us), 0u, FK_GUARD_HISTORY);
    u64(walk, &limb->off_us);
    const uint32_t was_cut = number_within(walk, limb->was_cut, 0u, 1u);
    if (to != 0) {
        to->was_cut = (uint16_t)was_cut;
        to->next = (uint16_t)(count % FK_GUARD_HISTORY);
    }
    for (uint32_t i = 0u; i < ((to != 0) ? FK_GUARD_HISTORY : count); ++i) {
        const uint32_t at = (limb->next + FK_GUARD_HISTORY - count + i) % FK_GUARD_HISTORY;
        const uint32_t ago_us = (i < count) ? number(walk, (uint32_t)(now_us - limb->start_us[at]), 4u) : 0u;
        const uint32_t on_us = (i < count) ? number(walk, limb->on_us[at], 4u) : 0u;
        if (to != 0) {
            walk->wrong |= (ago_us > now_us) ? 1 : 0;
            to->start_us[i] = (i < count) ? now_us - ago_us : 0u;
            to->on_us[i] = on_us;
        }
    }
}

static void walk_guard(fk_walk_t *walk, const fk_guard_t *guard)
{
    u64(walk, &guard->fix_us);
    const uint32_t closed_loop = number_within(walk, guard->closed_loop, 0u, 1u);
    if (walk->to != 0) {
        walk->to->guard.closed_loop = closed_loop;
    }
    for (uint32_t limb = 0u; limb < walk->robot->tables.limbs; ++limb) {
        walk_pulses(walk, &guard->limbs[limb]);
    }
}

static void walk_robot_state(fk_walk_t *walk)
{
    const fk_robot_t *robot = walk->robot;
    u64(walk, &robot->now_us);
    u8(walk, &robot->state, FK_STATE_DISARMED, FK_STATE_RUNNING); /* no snapshot is taken in FAULT */
    u32(walk, &robot->period_us);
    u32(walk, &robot->decisions);
    u64(walk, &robot->next_decision_us);
    u8(walk, &robot->stroke_request, 0u, robot->tables.actions + 1u);
    u64(walk, &robot->stroke_us);
    u8(walk, &robot->second_mask, 0u, (1u << robot->tables.limbs) - 1u);
    u64(walk, &robot->second_us);
    u64(walk, &robot->free_us);
    u8(walk, &robot->all_off, 0u, 1u);
    u8(walk, &robot->supply, 0u, FK_SUPPLY_LOW);
    walk_plan(walk, &robot->plan);
    walk_path(walk, &robot->path, &robot->path_points, &robot->path_total);
    walk_path(walk, &robot->coming, &robot->coming_points, &robot->coming_total);
    walk_follow(walk, &robot->follow);
    walk_estimator(walk, &robot->estimator);
    walk_guard(walk, &robot->guard);
}

/* What no field tells alone. */
static int32_t fits_together(const fk_robot_t *robot)
{
    const int32_t is_on_path = robot->path.count > 0u && robot->follow.along_points <= (float)(robot->path.count - 1u);
    return robot->period_us >= fk_fit_stroke_us(&robot->tables) && robot->plan.transitions_max > 0u &&
           (robot->state != FK_STATE_RUNNING || is_on_path);
}

void fk_robot_log_snapshot(const fk_robot_t *robot)
{
    fk_walk_t walk = {robot, 0, 0, 0u, 0, 0u, {0u}, {0u, 0u, robot->log_broken, robot->tables.image_crc32}};
    walk_robot_state(&walk);
    walk.part.last = 1u;
    write_part(&walk);
}

int32_t fk_robot_restore(fk_robot_t *robot, const uint8_t *snapshot, uint32_t length)
{
    fk_walk_t walk = {robot, robot, snapshot, length, 0, 0u, {0u}, {0u, 0u, 0u, 0u}};
    walk_robot_state(&walk);
    fk_guard_seal(&robot->guard);
    robot->log_broken = 0u;
    robot->log_mark = robot->log->end;
    robot->replays = 1u;
    return (walk.wrong == 0 && walk.left == 0u && fits_together(robot)) ? 0 : -1;
}
