/* A stage for the robot's Zephyr application: its two threads, one at a time, in simulated time, and as much of the
 * kernel (here), of Bluetooth (played_radio.c) and of clock, supply, timer and gates (played_gates.c) as they touch.
 * tests/firmware/zephyr_robot.py plays on it.
 *
 * Threads switch where they wait and nowhere else, so that a life is the same every time. Computing takes no time. */
#include <errno.h>
#include <pthread.h>
#include <string.h>

#include "crypto.h"
#include "played.h"

#define THREADS 2 /* 0: main, of Zephyr's default priority 0; 1: the one that the application defines */
#define TICKS_PER_S 32768u
#define SWITCHES_MAX 1000000

int fk_zephyr_main(void);

const struct device declared_device = {"stand-in"};

/* Time and threads */

typedef struct {
    pthread_t thread;
    struct k_sem *sem; /* waits for it, or NULL */
    uint64_t until_us;
    int waits;
    int gave; /* the semaphore, not the time, ended its wait */
} player_t;

static pthread_mutex_t baton = PTHREAD_MUTEX_INITIALIZER;
static pthread_cond_t passed = PTHREAD_COND_INITIALIZER;
static player_t players[THREADS];
static int on_stage = -1; /* -1: the test */
uint64_t now_us;
static int switches;

static void hand_over(int to)
{
    const int me = on_stage;
    on_stage = to;
    pthread_cond_broadcast(&passed);
    while (on_stage != me) {
        pthread_cond_wait(&passed, &baton);
    }
}

/* @return 1 where the semaphore was given, 0 where the time was over */
int wait_for(struct k_sem *sem, uint64_t until_us)
{
    player_t *player = &players[on_stage];
    player->sem = sem;
    player->until_us = until_us;
    player->waits = 1;
    hand_over(-1);
    return player->gave;
}

static int is_ready(player_t *player)
{
    if (player->waits == 0) {
        return 1;
    }
    if (player->sem != NULL && player->sem->count > 0) {
        --player->sem->count;
        player->gave = 1;
    } else if (player->until_us <= now_us) {
        player->gave = 0;
    } else {
        return 0;
    }
    player->waits = 0;
    return 1;
}

k_timeout_t declared_usec(uint64_t microseconds)
{
    return (k_timeout_t){(int64_t)((microseconds == UINT64_MAX) ? -1 : (int64_t)microseconds)};
}

static uint64_t end_of(k_timeout_t timeout)
{
    /* Whole ticks, one more than begun: no wait is shorter than it was told. */
    const uint64_t ticks = now_us * TICKS_PER_S / 1000000u + (uint64_t)timeout.ticks * TICKS_PER_S / 1000000u + 2u;
    return (timeout.ticks < 0) ? NEVER : (ticks * 1000000u + TICKS_PER_S - 1u) / TICKS_PER_S;
}

void k_sem_give(struct k_sem *sem) { sem->count = 1; }

int k_sem_take(struct k_sem *sem, k_timeout_t timeout)
{
    if (sem->count > 0) {
        --sem->count;
        return 0;
    }
    if (timeout.ticks == 0) {
        return -EBUSY;
    }
    return wait_for(sem, end_of(timeout)) ? 0 : -EAGAIN;
}

int32_t k_sleep(k_timeout_t timeout)
{
    (void)wait_for(NULL, end_of(timeout));
    return 0;
}

int64_t k_uptime_ticks(void) { return (int64_t)(now_us * TICKS_PER_S / 1000000u); }
int64_t k_uptime_get(void) { return (int64_t)(now_us / 1000u); }
uint64_t k_ticks_to_us_floor64(uint64_t t) { return t * 1000000u / TICKS_PER_S; }
int k_work_submit(struct k_work *work)
{
    work->handler(work);
    return 0;
}
void played_spend(uint64_t us)
{
    const uint64_t until_us = now_us + us;
    while (played_gates_next_us() <= until_us) {
        now_us = played_gates_next_us();
        played_gates_event();
    }
    now_us = until_us;
}
static uint64_t interrupt_us; /* that an interrupt takes which has waited for irq_unlock() */
void play_interrupt(uint64_t us) { interrupt_us = us; }
unsigned int irq_lock(void) { return 0; }
void irq_unlock(unsigned int) { played_spend(interrupt_us); }
bool atomic_cas(atomic_t *target, atomic_val_t old_value, atomic_val_t new_value)
{
    const bool equal = *target == old_value;
    *target = equal ? new_value : *target;
    return equal;
}
atomic_val_t atomic_set(atomic_t *target, atomic_val_t value)
{
    const atomic_val_t before = *target;
    *target = value;
    return before;
}
atomic_val_t atomic_get(const atomic_t *target) { return *target; }
atomic_val_t atomic_inc(atomic_t *target) { return (*target)++; }
void printk(const char *fmt, ...) { (void)fmt; }

/* The only ring buffer of the application. */
static uint8_t ring[4096];
static uint32_t ring_in;
static uint32_t ring_out;
uint32_t ring_buf_put(struct ring_buf *buf, const uint8_t *data, uint32_t size)
{
    uint32_t put = 0;
    while (put < size && ring_in - ring_out < buf->size) {
        ring[ring_in++ % sizeof(ring)] = data[put++];
    }
    return put;
}
uint32_t ring_buf_get(struct ring_buf *buf, uint8_t *data, uint32_t size)
{
    uint32_t got = 0;
    (void)buf;
    while (got < size && ring_in != ring_out) {
        data[got++] = ring[ring_out++ % sizeof(ring)];
    }
    return got;
}

/* Drivers */

static uint64_t fed_us;
static uint64_t fed_gap_us; /* the longest time between two feeds */
int wdt_install_timeout(const struct device *, const struct wdt_timeout_cfg *) { return 0; }
int wdt_setup(const struct device *, uint8_t)
{
    fed_us = now_us;
    return 0;
}
static uint64_t gap_us(void) { return (now_us - fed_us > fed_gap_us) ? now_us - fed_us : fed_gap_us; }
int wdt_feed(const struct device *, int)
{
    fed_gap_us = gap_us();
    fed_us = now_us;
    return 0;
}
uint8_t declared_flash[0x32000] __attribute__((aligned(4096)));
int flash_erase(const struct device *, off_t offset, size_t size)
{
    memset((void *)(uintptr_t)offset, 0xFF, size);
    return 0;
}
int flash_write(const struct device *, off_t offset, const void *data, size_t len)
{
    for (size_t i = 0; i < len; ++i) {
        ((uint8_t *)(uintptr_t)offset)[i] &= ((const uint8_t *)data)[i];
    }
    return 0;
}
int settings_load(void) { return 0; }
static uint32_t reset_cause; /* 0: it was switched on */
ssize_t hwinfo_get_device_id(uint8_t *buffer, size_t length)
{
    memset(buffer, 1, length);
    return (ssize_t)length;
}
int hwinfo_get_reset_cause(uint32_t *cause)
{
    *cause = reset_cause;
    return 0;
}
void play_reset_cause(uint32_t cause) { reset_cause = cause; }
int bt_rand(void *buf, size_t len)
{
    for (size_t i = 0; i < len; ++i) {
        ((uint8_t *)buf)[i] = (uint8_t)(37u * i + 11u);
    }
    return 0;
}
int hwinfo_clear_reset_cause(void) { return 0; }

/* The test's side */

static uint64_t least(uint64_t a, uint64_t b) { return (a < b) ? a : b; }

static void *play_thread(void *player)
{
    const int me = (int)((player_t *)player - players);
    pthread_mutex_lock(&baton);
    while (on_stage != me) {
        pthread_cond_wait(&passed, &baton);
    }
    if (me == 0) {
        (void)fk_zephyr_main();
    } else {
        declared_thread.entry(NULL, NULL, NULL);
    }
    (void)wait_for(NULL, NEVER);
    return NULL;
}

void play_begin(void)
{
    memset(declared_flash, 0xFF, sizeof(declared_flash));
    for (int i = 0; i < THREADS; ++i) {
        (void)pthread_create(&players[i].thread, NULL, play_thread, &players[i]);
    }
}

/* @return 0, or 1 where threads go on for ever without time going on */
int play_until(uint64_t until_us)
{
    pthread_mutex_lock(&baton);
    switches = 0;
    for (;;) {
        int ready = 0;
        while (ready < THREADS && !is_ready(&players[ready])) {
            ++ready;
        }
        if (ready < THREADS) {
            hand_over(ready);
            if (++switches > SWITCHES_MAX) {
                break;
            }
            continue;
        }
        uint64_t next_us = least(played_gates_next_us(), played_radio_next_us());
        next_us = least(next_us, least(players[0].until_us, players[1].until_us));
        if (next_us > until_us) {
            now_us = until_us;
            break;
        }
        now_us = next_us;
        played_gates_event();
        played_radio_event();
    }
    pthread_mutex_unlock(&baton);
    return switches > SWITCHES_MAX;
}

uint64_t play_watchdog_us(void) { return gap_us(); }
