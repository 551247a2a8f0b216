/* Tests only: bytes to the robot as a radio or a stranger may send them, each judged by a decoder of its own.
 *
 * A frame that is none, or an answer or event, may change nothing but the count of bad frames; every other one is answered
 * once, with its type and its sequence number; and after whatever came, the next good frame is taken. Nobody here has the key of
 * a robot that has an owner: it may be switched off, and no more.
 */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "fk_robot_state.h"

#define ROOM (FK_FRAME_ENCODED_MAX + 64u)

enum { /* what is counted */
    FUZZ_GOOD = 0,
    FUZZ_BAD = 1,
    FUZZ_ANSWERS = 2,
    FUZZ_PULSES = 3,
    FUZZ_REPEATS = 4,
    FUZZ_COUNTS = 5
};

static fk_robot_t robot;
static fk_robot_t fresh;
static fk_log_t history;
static fk_robot_t before;
static uint8_t region[(FK_STORE_JOURNAL_PAGES + 1u) * FK_FLASH_PAGE_BYTES];
static const fk_flash_t flash = {region, FK_FLASH_PAGE_BYTES, 1u, NULL};
static fk_store_t store; /* of a robot with an owner */
static fk_frame_collector_t into;
static fk_frame_collector_t out_of;
static const uint8_t *table_image;
static uint64_t now_us;
static uint64_t counts[FUZZ_COUNTS];
static const char *wrong; /* what did not hold */

/* CRC-32 and COBS once more, in the plainest way. */
static uint32_t crc_of(const uint8_t *bytes, uint32_t length)
{
    uint32_t crc = 0xFFFFFFFFu;
    for (uint32_t i = 0u; i < length; ++i) {
        crc ^= bytes[i];
        for (uint32_t bit = 0u; bit < 8u; ++bit) {
            crc = (crc >> 1) ^ ((crc & 1u) != 0u ? 0xEDB88320u : 0u);
        }
    }
    return ~crc;
}

/* Length of the raw frame, or -1 where these bytes are no frame of this link. */
static int32_t decoded(const uint8_t *encoded, uint32_t length, uint8_t *raw)
{
    uint32_t count = 0u;
    uint32_t at = 0u;
    while (at < length) {
        uint32_t code = encoded[at];
        if (code == 0u || at + code > length) {
            return -1;
        }
        for (uint32_t i = 1u; i < code; ++i) {
            if (encoded[at + i] == 0u || count >= ROOM) {
                return -1;
            }
            raw[count++] = encoded[at + i];
        }
        at += code;
        if (at < length && code < 255u) {
            if (count >= ROOM) {
                return -1;
            }
            raw[count++] = 0u;
        }
    }
    if (count < 6u || count > 6u + FK_PAYLOAD_BYTES_MAX) {
        return -1;
    }
    uint32_t told = raw[count - 4u] | (uint32_t)raw[count - 3u] << 8 | (uint32_t)raw[count - 2u] << 16 |
                    (uint32_t)raw[count - 1u] << 24;
    return (told == crc_of(raw, count - 4u)) ? (int32_t)count : -1;
}

static uint32_t encoded_of(const uint8_t *raw, uint32_t length, uint8_t *encoded)
{
    uint8_t whole[ROOM];
    uint32_t code_at = 0u;
    uint32_t at = 1u;
    memcpy(whole, raw, length);
    uint32_t crc = crc_of(raw, length);
    for (uint32_t i = 0u; i < 4u; ++i) {
        whole[length + i] = (uint8_t)(crc >> (8u * i));
    }
    for (uint32_t i = 0u; i < length + 4u; ++i) {
        if (whole[i] == 0u) {
            encoded[code_at] = (uint8_t)(at - code_at);
            code_at = at;
        } else {
            encoded[at] = whole[i];
        }
        ++at;
    }
    encoded[code_at] = (uint8_t)(at - code_at);
    return at;
}

/* All that the robot has to send; the type and number of the last answer, 0 where there was none. Events may come with
 * it: a fix that ends a run is answered, and the end told. */
static uint32_t hear(void)
{
    uint8_t bytes[FK_FRAME_ENCODED_MAX];
    uint8_t raw[ROOM];
    uint32_t last = 0u;
    uint32_t count;
    while ((count = fk_robot_take_tx(&robot, bytes, sizeof(bytes))) > 0u) {
        for (uint32_t i = 0u; i < count; ++i) {
            uint32_t length = fk_frame_collect(&out_of, bytes[i]);
            if (length > 0u) {
                if (decoded(out_of.bytes, length, raw) < 0) {
                    wrong = "the robot sent a torn frame";
                    return 0u;
                }
                last = (raw[0] & FK_ANSWER_BIT) != 0u ? 0x10000u | (uint32_t)raw[0] << 8 | raw[1] : last;
            }
        }
    }
    return last;
}

static void live(uint64_t more_us)
{
    fk_outputs_t outputs;
    now_us += more_us;
    fk_robot_tick(&robot, now_us, &outputs);
    counts[FUZZ_PULSES] += (outputs.limb_mask != 0u) ? 1u : 0u;
    (void)hear();
}

/* What a stranger's frame has done to a robot with an owner, beside switching it off. */
static void look_at_owned(void)
{
    const int32_t is_off = robot.state == before.state || robot.state == FK_STATE_DISARMED ||
                           (before.state == FK_STATE_RUNNING && robot.state == FK_STATE_ARMED);
    if (!is_off || (robot.stroke_request != 0u && robot.stroke_request != before.stroke_request) ||
        memcmp(&robot.path, &before.path, sizeof(robot.path)) != 0 ||
        memcmp(&robot.coming, &before.coming, sizeof(robot.coming)) != 0 ||
        memcmp(&robot.plan, &before.plan, sizeof(robot.plan)) != 0 || robot.period_us != before.period_us ||
        robot.fixes_used != before.fixes_used || robot.path_points != before.path_points ||
        robot.heard_us != before.heard_us || store.open != 0u || !fk_store_is_owned(&store)) {
        wrong = "a stranger commanded a robot with an owner";
    }
}

static void deliver(const uint8_t *encoded, uint32_t length)
{
    uint8_t raw[ROOM];
    /* Exactly as many bytes as the frame has: what reads beyond them reads somebody else's. */
    uint8_t *exact = malloc(length);
    memcpy(exact, encoded, length);
    int32_t size = decoded(exact, length, raw);
    if (size >= 0 && (raw[0] & 0xC0u) == 0u) {
        const uint32_t type = raw[0] & 0xDFu; /* with a code: as without */
        memcpy(&before, &robot, sizeof(robot));
        fk_robot_on_frame(&robot, exact, length, now_us);
        uint32_t heard = hear();
        if (heard != (0x10000u | (type | FK_ANSWER_BIT) << 8 | raw[1])) {
            wrong = "a good frame was not answered by its type and number";
        }
        if (robot.store != NULL) {
            look_at_owned();
        }
        ++counts[FUZZ_GOOD];
        ++counts[FUZZ_ANSWERS];
    } else {
        memcpy(&before, &robot, sizeof(robot));
        uint32_t logged = history.end;
        fk_robot_on_frame(&robot, exact, length, now_us);
        ++before.frames_bad;
        if (memcmp(&before, &robot, sizeof(robot)) != 0 || history.end != logged) {
            wrong = "a bad frame changed the robot";
        }
        ++counts[FUZZ_BAD];
    }
    free(exact);
}

static void stream(const uint8_t *bytes, uint32_t length)
{
    for (uint32_t i = 0u; i < length; ++i) {
        uint32_t found = fk_frame_collect(&into, bytes[i]);
        if (found > 0u) {
            deliver(into.bytes, found);
        }
    }
}

static void good_frame(uint8_t type, uint8_t sequence, const uint8_t *payload, uint32_t length)
{
    uint8_t raw[ROOM];
    uint8_t encoded[ROOM];
    raw[0] = type;
    raw[1] = sequence;
    for (uint32_t i = 0u; i < length; ++i) {
        raw[2u + i] = payload[i];
    }
    deliver(encoded, encoded_of(raw, length + 2u, encoded));
}

/* Whatever came before: a delimiter, and the next frame is taken. */
static void resynchronise(uint8_t sequence)
{
    uint8_t raw[2] = {FK_FRAME_STATUS, sequence};
    uint8_t encoded[ROOM];
    uint64_t good = counts[FUZZ_GOOD];
    uint32_t length = encoded_of(raw, 2u, encoded + 1) + 2u;
    encoded[0] = 0u;
    encoded[length - 1u] = 0u;
    stream(encoded, 1u);
    good = counts[FUZZ_GOOD];
    stream(encoded + 1, length - 1u);
    if (counts[FUZZ_GOOD] != good + 1u) {
        wrong = "the next good frame was not taken";
    }
}

/* The lower two bits: its state; the third: it has an owner, who has put it there. */
static void begin(uint32_t kind)
{
    const uint32_t state = kind & 3u;
    static const uint8_t two_points[3u + 2u * 12u] = {0u, 2u, 2u, 0u, 0u, 0u, 0u, 0u, 0u, 0u, 0u, 0u, 0u, 0u,
                                                      0u, 0u, 0u, 0x80u, 0x3fu};
    uint8_t fix[FK_FIX_COMMAND_BYTES] = {1u, 0u, 1u};
    static const uint8_t delay[4] = {0u, 0u, 0u, 0u};
    memcpy(&robot, &fresh, sizeof(robot));
    robot.estimator.track.tables = &robot.tables;
    history.magic = 0u;
    fk_robot_use_log(&robot, &history);
    into.length = 0u;
    out_of.length = 0u;
    now_us = 4294000000u;
    live(0u);
    if (state >= 1u) {
        good_frame(FK_FRAME_ARM, 250u, 0, 0u);
        good_frame(FK_FRAME_PATH, 251u, two_points, sizeof(two_points));
        good_frame(FK_FRAME_FIX, 252u, fix, sizeof(fix));
    }
    if (state == 2u) {
        good_frame(FK_FRAME_START, 253u, delay, sizeof(delay));
    }
    if (state == 3u) {
        fk_robot_note_pulse_failed(&robot, -1);
    }
    if ((kind & 4u) != 0u) {
        memset(&store, 0, sizeof(store));
        store.flash = &flash;
        store.built_in = table_image;
        store.record.owner_key[7] = 1u;
        robot.store = &store;
    }
}

/* One input: its first byte says in which state the robot is, and whether bytes or frames follow. Of a frame: what
 * becomes of it, type, sequence number, length, payload. */
static void one_input(const uint8_t *data, uint32_t size)
{
    if (size == 0u) {
        return;
    }
    begin((data[0] & 3u) | (data[0] & 8u) >> 1);
    if ((data[0] & 4u) != 0u) {
        stream(data + 1, size - 1u);
    }
    for (uint32_t at = 1u; (data[0] & 4u) == 0u && at + 4u <= size;) {
        const uint8_t *head = data + at;
        uint32_t length = head[3];
        at += 4u;
        if ((head[0] & 3u) == 3u) {
            live((uint64_t)head[1] << (head[2] & 15u));
            continue;
        }
        length = (length > size - at) ? size - at : length;
        length = (length > FK_PAYLOAD_BYTES_MAX + 16u) ? FK_PAYLOAD_BYTES_MAX + 16u : length;
        uint8_t raw[ROOM];
        uint8_t encoded[ROOM + 1u];
        raw[0] = head[1];
        raw[1] = head[2];
        memcpy(raw + 2, data + at, length);
        at += length;
        uint32_t many = encoded_of(raw, length + 2u, encoded);
        if ((head[0] & 3u) == 1u) {
            encoded[(head[0] >> 5) % many] ^= (uint8_t)(1u << (head[0] >> 2 & 7u));
        } else if ((head[0] & 3u) == 2u) {
            many -= (uint32_t)(head[0] >> 2) % many;
        }
        encoded[many] = 0u;
        stream(encoded, many + 1u);
        live(1000u);
    }
    resynchronise(249u);
    counts[FUZZ_REPEATS] += robot.commands_repeated;
}

static int32_t open_robot(const uint8_t *table, uint32_t bytes)
{
    table_image = table;
    return fk_robot_init(&fresh, table, bytes);
}

int LLVMFuzzerInitialize(int *argc, char ***argv);
int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

/* The table's file is named by FK_FUZZ_TABLE. */
int LLVMFuzzerInitialize(int *argc, char ***argv)
{
    static uint32_t table[65536];
    const char *name = getenv("FK_FUZZ_TABLE");
    FILE *file = (name != NULL) ? fopen(name, "rb") : NULL;
    uint32_t bytes = (file != NULL) ? (uint32_t)fread(table, 1u, sizeof(table), file) : 0u;
    (void)argc;
    (void)argv;
    if (file != NULL) {
        (void)fclose(file);
    }
    if (open_robot((const uint8_t *)table, bytes) != 0) {
        (void)fprintf(stderr, "no table in FK_FUZZ_TABLE\n");
        exit(2);
    }
    return 0;
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    one_input(data, (uint32_t)size);
    if (wrong != NULL) {
        (void)fprintf(stderr, "%s\n", wrong);
        abort();
    }
    return 0;
}

/* Random frames by the million: whole ones with random contents, damaged ones, random bytes. */
const char *fk_fuzz(const uint8_t *table, uint32_t bytes, uint64_t seed, uint64_t frames, uint64_t *told);

static uint64_t random_state;

static uint32_t below(uint32_t most)
{
    random_state ^= random_state << 13;
    random_state ^= random_state >> 7;
    random_state ^= random_state << 17;
    return (uint32_t)((random_state >> 32) * most >> 32);
}

static uint32_t any_payload(uint8_t type, uint8_t *payload)
{
    static const uint8_t lengths[] = {0u, 3u, 0u, 0u, 19u, 27u, 4u, 0u, 0u, 5u, 1u, 45u, 0u};
    uint32_t length = (type < sizeof(lengths) && below(8u) != 0u) ? lengths[type] : below(FK_PAYLOAD_BYTES_MAX + 1u);
    length = (type == FK_FRAME_LOG && below(8u) != 0u) ? FK_LOG_COMMAND_BYTES : length;
    uint32_t kind = below(4u);
    for (uint32_t i = 0u; i < length; ++i) {
        payload[i] = (uint8_t)(kind == 0u ? below(256u) : kind == 1u ? below(3u) : (below(4u) == 0u) ? below(256u) : 0u);
    }
    return length;
}

const char *fk_fuzz(const uint8_t *table, uint32_t bytes, uint64_t seed, uint64_t frames, uint64_t *told)
{
    uint8_t raw[ROOM];
    uint8_t encoded[2u * ROOM];
    memset(counts, 0, sizeof(counts));
    wrong = (open_robot(table, bytes) == 0) ? NULL : "no table";
    random_state = seed * 0x9E3779B97F4A7C15u + 1u;
    for (uint32_t i = 0u; i < 8u; ++i) {
        (void)below(2u);
    }
    for (uint32_t n = 0u; counts[FUZZ_GOOD] + counts[FUZZ_BAD] < frames && wrong == NULL; ++n) {
        if (n % 64u == 0u) {
            if (n > 0u) {
                counts[FUZZ_REPEATS] += robot.commands_repeated;
            }
            begin(below(8u));
        }
        raw[0] = (uint8_t)((below(8u) != 0u) ? 1u + below(11u) : (below(4u) == 0u) ? FK_FRAME_LOG : below(256u));
        raw[0] |= (raw[0] < FK_AUTH_BIT && below(16u) == 0u) ? FK_AUTH_BIT : 0u;
        raw[1] = (uint8_t)((below(8u) != 0u) ? n : below(256u));
        uint32_t length = encoded_of(raw, 2u + any_payload(raw[0], raw + 2), encoded);
        switch (below(8u)) {
        case 0u:
        case 1u:
            break; /* as it is */
        case 2u: /* some bits flipped */
            for (uint32_t k = 1u + below(4u); k > 0u; --k) {
                encoded[below(length)] ^= (uint8_t)(1u << below(8u));
            }
            break;
        case 3u: /* cut */
            length = 1u + below(length);
            break;
        case 4u: { /* a part is missing */
            uint32_t gone = below(length);
            uint32_t from = below(length - gone);
            memmove(encoded + from, encoded + from + gone, length - from - gone);
            length -= gone;
            break;
        }
        case 5u: { /* a part comes twice */
            uint32_t part = below(length + 1u);
            memmove(encoded + part + below(2u), encoded, length);
            length += part;
            break;
        }
        case 6u: /* noise */
            length = 1u + below(ROOM);
            for (uint32_t k = 0u; k < length; ++k) {
                encoded[k] = (uint8_t)below(256u);
            }
            break;
        default: /* nothing but zeros, or but ones, or far too long */
            length = 1u + below(2u * ROOM - 1u);
            memset(encoded, below(2u) != 0u ? 0 : (int)below(256u), length);
            break;
        }
        encoded[length] = 0u;
        stream(encoded, length + ((below(4u) != 0u) ? 1u : 0u)); /* with or without its delimiter */
        if (below(16u) == 0u) {
            stream(encoded, length + 1u); /* doubled */
        }
        if (below(4u) == 0u) {
            resynchronise((uint8_t)n);
        }
        live((below(8u) == 0u) ? below(300000u) : 0u);
    }
    memcpy(told, counts, sizeof(counts));
    return wrong;
}
