/* Tests only: random command sequences to a robot and the port that would carry out what it asks for. What an onlooker
 * with a clock sees of it, radio and pins, is written down, and judged elsewhere.
 */
#include "fk_robot_state.h"
#include "play.h"

#define LIMBS 4u
#define KEPT 8u
#define FRAME_BYTES (FK_FRAME_ENCODED_MAX + 2u)

typedef struct {
    uint8_t bytes[FRAME_BYTES];
    uint32_t length;
    int32_t heard;  /* what it is to an onlooker, 0: nothing */
    int64_t age_us; /* of a FIX's picture, whenever it comes; negative: no FIX */
} sent_t;

static fk_robot_t robot;
static const uint8_t *image;
static uint32_t image_bytes;

static uint64_t random_state;
static seen_t *seen;
static uint32_t seen_count;
static uint32_t seen_capacity;

static int64_t world_us; /* the onlooker's clock */
static int64_t boot_us;  /* when the robot's clock was 0, on it */
static int64_t due_us;   /* when the core wants its next tick */
static int64_t pin_us;   /* last time that the port touched the pins */
static int64_t off_us;   /* when the pulse under way ends */
static int64_t low_us;   /* when the last one ended */
static int64_t last_lows_us[8];
static uint32_t low_count;
static int64_t fix_us;   /* capture of the last fix that came to the robot */
static uint32_t on_mask;
static uint32_t busy;    /* pulses that the core asked for while one was on: never */
static uint8_t sequence;
static uint32_t fixes;
static uint32_t hint; /* what to command next; 100: anything */
static sent_t sent[KEPT];
static uint32_t sent_count;
static uint32_t is_again; /* what the robot hears now it has heard before: its answer is the one of then */
static fk_frame_collector_t collector;
static fk_guard_persistent_t kept; /* RAM that a reset leaves alone */
static const fk_guard_persistent_t cold = {{0u}, 0x190a55adu ^ 0x64726147u}; /* the first: CRC-32 of 32 zeros */
static fk_log_t history;     /* likewise */

static uint64_t draw(void)
{
    uint64_t z = (random_state += 0x9E3779B97F4A7C15u); /* splitmix64 */
    z = (z ^ (z >> 30)) * 0xBF58476D1CE4E5B9u;
    z = (z ^ (z >> 27)) * 0x94D049BB133111EBu;
    return z ^ (z >> 31);
}

static uint32_t below(uint32_t most) { return (uint32_t)((draw() >> 32) * most >> 32); }

static void see(int64_t time_us, int32_t kind, int32_t value)
{
    if (seen_count < seen_capacity) {
        seen_t one = {time_us, kind, value};
        seen[seen_count] = one;
    }
    ++seen_count;
}

static void lows(int64_t at_us)
{
    for (uint32_t limb = 0u; limb < LIMBS; ++limb) {
        if ((on_mask >> limb & 1u) != 0u) {
            see(at_us, SEEN_LOW, (int32_t)limb);
        }
    }
    if (on_mask != 0u) {
        low_us = at_us;
        last_lows_us[low_count++ % 8u] = at_us;
    }
    on_mask = 0u;
}

/* The hardware timer, which needs no core. */
static void pins_until(int64_t at_us)
{
    if (on_mask != 0u && off_us <= at_us) {
        lows(off_us);
    }
}

/* A port does one thing after the other, each up to FK_PORT_LATE_US after the time that it told the core. */
static void touch_pins(void)
{
    int64_t at_us = world_us + below(FK_PORT_LATE_US + 1u);
    pin_us = (at_us > pin_us) ? at_us : pin_us;
    pins_until(pin_us);
}

static uint64_t clock_us(void) { return (uint64_t)(world_us - boot_us); }

/* What the robot says, as an onlooker hears it. */
static void listen(void)
{
    static uint8_t bytes[FK_TX_BYTES];
    uint32_t count;
    while ((count = fk_robot_take_tx(&robot, bytes, sizeof(bytes))) > 0u) {
        for (uint32_t i = 0u; i < count; ++i) {
            fk_frame_t frame;
            uint32_t length = fk_frame_collect(&collector, bytes[i]);
            if (length == 0u || fk_frame_decode(collector.bytes, length, &frame) != 0) {
                continue;
            }
            int32_t is_ok = frame.payload_length > 0u && frame.payload[0] == 0u;
            if (frame.type == (FK_FRAME_START | FK_ANSWER_BIT) && is_ok && is_again == 0u) {
                see(world_us, SEEN_STARTED, 0);
            } else if (frame.type == (FK_FRAME_FIX | FK_ANSWER_BIT) && is_ok) {
                see(fix_us, SEEN_FIX, 0);
            } else if (frame.type == (FK_FRAME_STATUS | FK_ANSWER_BIT) && is_ok) {
                see(world_us, SEEN_STATE, frame.payload[1]);
            } else if (frame.type == FK_FRAME_ENDED) {
                see(world_us, SEEN_ENDED, 0);
            }
        }
    }
}

static void tick(void)
{
    fk_outputs_t outputs;
    uint64_t now_us = clock_us();
    fk_robot_tick(&robot, now_us, &outputs);
    due_us = (outputs.next_tick_us >= (uint64_t)INT64_MAX - (uint64_t)(boot_us > 0 ? boot_us : 0))
                 ? INT64_MAX
                 : (int64_t)outputs.next_tick_us + boot_us;
    if (outputs.all_off != 0u) {
        touch_pins();
        lows(pin_us);
    }
    if (outputs.limb_mask != 0u) {
        touch_pins();
        if (on_mask != 0u) {
            ++busy;
            fk_robot_note_pulse_failed(&robot, -2);
            see(world_us, SEEN_FAULT, 0);
        } else if (below(100u) == 0u) { /* held up for longer than the core allows for */
            fk_robot_note_pulse_failed(&robot, FK_PULSE_LATE);
        } else {
            for (uint32_t limb = 0u; limb < LIMBS; ++limb) {
                if ((outputs.limb_mask >> limb & 1u) != 0u) {
                    see(pin_us, SEEN_HIGH, (int32_t)limb);
                }
            }
            on_mask = outputs.limb_mask;
            off_us = pin_us + (int64_t)outputs.pulse_us - (int64_t)below(2u);
        }
    }
    world_us = (pin_us > world_us) ? pin_us : world_us;
    listen();
}

static void live_until(int64_t until_us)
{
    static const uint32_t late_us[] = {0u, 0u, 0u, 0u, 1u, 15u, 400u, 30000u};
    for (uint32_t turns = 0u; due_us < until_us && turns < 1000u; ++turns) {
        int64_t at_us = due_us + late_us[below(8u)];
        world_us = (at_us > world_us) ? at_us : world_us;
        pins_until(world_us);
        tick();
    }
    world_us = (until_us > world_us) ? until_us : world_us;
    pins_until(world_us);
}

static void start_robot(uint64_t clock)
{
    boot_us = world_us - (int64_t)clock;
    sent_count = 0u;
    is_again = 0u;
    collector.length = 0u;
    (void)fk_robot_init(&robot, image, image_bytes);
    fk_robot_note_reset(&robot, FK_RESET_UNKNOWN, &kept);
    fk_robot_use_log(&robot, &history);
    tick();
}

static void give(const sent_t *frame)
{
    fix_us = (frame->age_us >= 0) ? world_us - frame->age_us : fix_us;
    fk_robot_on_frame(&robot, frame->bytes, frame->length, clock_us());
    listen();
}

static void give_again(const sent_t *frame)
{
    is_again = 1u;
    if (frame->heard == SEEN_DISARM || frame->heard == SEEN_STOP) { /* what switches off acts whenever it comes */
        see(world_us, frame->heard, 0);
    }
    give(frame);
    is_again = 0u;
}

/* heard: what it is to an onlooker that this command reaches the robot, 0: nothing. */
static void send_as(int32_t heard, uint8_t type, const uint8_t *payload, uint32_t length)
{
    sent_t *frame = &sent[sent_count % KEPT];
    ++sequence;
    frame->heard = heard;
    frame->age_us = (type == FK_FRAME_FIX && length == FK_FIX_COMMAND_BYTES) ? (int64_t)fk_get_u32(payload + 3) : -1;
    frame->length = fk_frame_encode(type, sequence, payload, length, frame->bytes, sizeof(frame->bytes)) - 1u;
    uint32_t fate = below(64u);
    if (fate == 0u) { /* damaged on the way: it must do nothing */
        frame->bytes[below(frame->length)] ^= (uint8_t)(1u << below(8u));
        give(frame);
        return;
    }
    if (fate == 1u) { /* lost */
        return;
    }
    ++sent_count;
    if (heard != 0) {
        see(world_us, heard, 0);
    }
    give(frame);
    if (below(16u) == 0u) { /* doubled by the radio */
        give_again(frame);
    }
    tick();
}

static void send(uint8_t type, const uint8_t *payload, uint32_t length)
{
    static const int32_t heard[] = {0, 0, SEEN_ARM, SEEN_DISARM, 0, 0, 0, SEEN_STOP};
    send_as((type <= FK_FRAME_STOP) ? heard[type] : 0, type, payload, length);
}

static void send_fix(void)
{
    static const uint32_t ages_us[] = {0u, 1000u, 20000u, 100000u, 400000u, 499000u, 900000u, 1900000u};
    uint32_t age_us = ages_us[below(8u)];
    uint8_t payload[FK_FIX_COMMAND_BYTES];
    fk_put_u16(payload, (uint16_t)++fixes);
    fk_put_u8(payload + 2, (below(16u) != 0u) ? 1u : 0u);
    fk_put_u32(payload + 3, age_us);
    fk_put_f32(payload + 7, 0.3f + 1e-4f * (float)below(100u));
    fk_put_f32(payload + 11, (below(16u) != 0u) ? 0.0f : 0.5f);
    fk_put_f32(payload + 15, 0.0f);
    send(FK_FRAME_FIX, payload, sizeof(payload));
}

static void send_path(void)
{
    uint8_t payload[3u + 2u * 12u] = {0u, 2u, 2u};
    fk_put_f32(payload + 3u + 12u, 1.0f);
    send(FK_FRAME_PATH, payload, sizeof(payload));
}

static void send_start(void)
{
    static const uint32_t delays_us[] = {0u, 0u, 1u, 50000u, 400000u, 1900000u, 3000000u, 20000000u};
    uint8_t payload[4];
    fk_put_u32(payload, delays_us[below(8u)]);
    send(FK_FRAME_START, payload, sizeof(payload));
}

static void send_param(void)
{
    static const float values[] = {1.0f, 2.0f, 500000.0f, 700000.0f, 5000000.0f, 1e9f, -1.0f, 0.0f};
    uint8_t payload[5];
    payload[0] = (uint8_t)below(24u);
    fk_put_f32(payload + 1, values[below(8u)]);
    send(FK_FRAME_PARAM, payload, sizeof(payload));
}

static void send_anything(void)
{
    uint8_t payload[40];
    for (uint32_t i = 0u; i < sizeof(payload); ++i) {
        payload[i] = (uint8_t)below(256u);
    }
    /* Of the types that change something only with a length that they do not take. */
    uint8_t type = (uint8_t)below(128u);
    uint32_t length = below(sizeof(payload));
    if (type >= FK_FRAME_ARM && type <= FK_FRAME_STOP) {
        length = 30u;
    }
    send_as(0, type, payload, length);
}

static void again(void)
{
    if (sent_count > 0u) {
        /* Not the oldest place: the frame that was damaged or lost last stands there. */
        uint32_t back = 1u + below((sent_count < KEPT) ? sent_count : KEPT - 1u);
        give_again(&sent[(sent_count - back) % KEPT]);
        tick();
    }
}

static void reset(void)
{
    lows(world_us); /* pins are inputs now */
    see(world_us, SEEN_RESET, 0);
    world_us += below(3u) * 100000; /* what the start takes; the clock begins after it */
    uint32_t damage = below(8u);
    if (damage == 0u) {
        ((uint8_t *)&kept)[below(sizeof(kept))] ^= (uint8_t)(1u << below(8u));
    } else if (damage == 1u) {
        kept.on_us[below(LIMBS)] = 0u;
    }
    start_robot(0u);
    if (below(2u) == 0u) {
        send(FK_FRAME_ARM, 0, 0u);
        send_path();
    }
}

static void go_wrong(void)
{
    uint64_t told_us = clock_us();
    tick();
    see(world_us, SEEN_FAULT, 0);
    if (below(2u) == 0u && told_us > 0u) {
        fk_outputs_t outputs;
        fk_robot_tick(&robot, told_us - 1u, &outputs);
        if (outputs.all_off != 0u) {
            touch_pins();
            lows(pin_us);
            world_us = (pin_us > world_us) ? pin_us : world_us;
        }
    } else {
        fk_robot_note_pulse_failed(&robot, -1);
    }
    tick();
}

/* A time to wait until something is done, often within some 0.3 ms of where a limit begins or ends to hold. */
static int64_t next_us(uint32_t mood)
{
    static const uint32_t gaps_us[] = {0u, 1u, 3000u, 30000u, 81000u, 161000u, 500000u, 1500000u};
    int64_t near_us = (int64_t)below(601u) - 300;
    hint = 100u;
    switch (below(8u)) {
    case 0u:
        hint = (below(2u) == 0u) ? 20u : hint; /* a stroke */
        return low_us + (int64_t)FK_REST_MIN_US + near_us;
    case 1u:
        return fix_us + 500000 + near_us;
    case 2u:
        return fix_us + 2000000 + near_us;
    case 3u:
        hint = (below(2u) == 0u) ? 20u : hint;
        /* An old pulse leaves the window that ends with one of now. */
        return last_lows_us[below(8u)] + 5000000 - 80000 + (int64_t)FK_PORT_LATE_US + near_us;
    default:
        return world_us + ((mood == 1u) ? 590000 : (int64_t)gaps_us[below(8u)]);
    }
}

static void command(uint32_t mood)
{
    uint32_t choice = (hint < 100u) ? hint : below(100u);
    uint8_t action = (uint8_t)below(robot.tables.actions + 1u);
    if (mood == 1u && choice < 80u) { /* strokes as close as they may be */
        action = 0u;
        choice = 20u;
    } else if (mood == 2u && choice < 50u) { /* a run, with fixes that come and go */
        choice = (choice < 30u) ? 50u : (choice < 40u) ? 40u : 80u;
    }
    if (choice < 15u) {
        send(FK_FRAME_ARM, 0, 0u);
    } else if (choice < 35u) {
        send(FK_FRAME_STROKE, &action, 1u);
    } else if (choice < 45u) {
        send_start();
    } else if (choice < 65u) {
        send_fix();
    } else if (choice < 70u) {
        send(FK_FRAME_DISARM, 0, 0u);
    } else if (choice < 74u) {
        send(FK_FRAME_STOP, 0, 0u);
    } else if (choice < 82u) {
        send(FK_FRAME_STATUS, 0, 0u);
    } else if (choice < 85u) {
        send_path();
    } else if (choice < 89u) {
        send_param();
    } else if (choice < 92u) {
        send_anything();
    } else if (choice < 98u) {
        again();
    } else if (choice < 99u) {
        reset();
    } else if (below(3u) == 0u) {
        go_wrong();
    }
}

static void one_sequence(uint32_t commands)
{
    static const uint64_t clocks_us[] = {0u, 400000u, 1000000u, 4294000000u, 1099511627776u};
    uint32_t mood = below(3u);
    world_us = 10000000;
    pin_us = low_us = fix_us = off_us = 0;
    low_count = 0u;
    for (uint32_t i = 0u; i < 8u; ++i) {
        last_lows_us[i] = 0;
    }
    on_mask = 0u;
    see(world_us, SEEN_POWER_ON, 0);
    kept = cold;
    kept.crc ^= (below(4u) == 0u) ? (uint32_t)draw() | 1u : 0u; /* RAM as the supply finds it */
    start_robot(clocks_us[below(5u)]);
    if (below(4u) != 0u) {
        send(FK_FRAME_ARM, 0, 0u);
        send_path();
        send_fix();
    }
    if (mood == 2u) {
        send_start();
    }
    for (uint32_t i = 0u; i < commands; ++i) {
        live_until(next_us(mood));
        command(mood);
    }
    live_until(world_us + 3000000);
}

uint32_t fk_play(const uint8_t *table, uint32_t bytes, uint64_t seed, uint32_t count, uint32_t commands, seen_t *to,
                 uint32_t capacity, uint32_t *busy_pulses);

/* Play sequences seed, seed + 1, ...; each gives the same whatever was played before it.
 * Returns the number of things seen, above capacity where they did not fit. */
uint32_t fk_play(const uint8_t *table, uint32_t bytes, uint64_t seed, uint32_t count, uint32_t commands, seen_t *to,
                 uint32_t capacity, uint32_t *busy_pulses)
{
    image = table;
    image_bytes = bytes;
    seen = to;
    seen_count = 0u;
    seen_capacity = capacity;
    busy = 0u;
    for (uint32_t i = 0u; i < count; ++i) {
        random_state = seed + i;
        sequence = 0u;
        fixes = 0u;
        one_sequence(commands);
    }
    *busy_pulses = busy;
    return seen_count;
}
