#include "fk_log.h"

#define LOG_MAGIC 0x314C4B46u /* "FKL1" */
#define CHECK_AT 2u           /* within the head: sum, then sum of sums */
#define TIME_AT 4u

typedef struct {
    uint8_t sum;
    uint8_t sums;
} fk_check_t;

static void add(fk_check_t *check, uint8_t byte)
{
    check->sum = (uint8_t)(check->sum + byte);
    check->sums = (uint8_t)(check->sums + check->sum);
}

/* Index in bytes[] of an offset from begin to end. */
static uint32_t place_of(const fk_log_t *log, uint32_t offset)
{
    uint32_t place = log->first + (offset - log->begin);
    return (place < FK_LOG_BYTES) ? place : place - FK_LOG_BYTES;
}

static void clear(fk_log_t *log)
{
    log->magic = LOG_MAGIC;
    log->begin = 0u;
    log->end = 0u;
    log->first = 0u;
    log->lost = 0u;
}

static int32_t is_record(const fk_log_t *log, uint32_t offset, uint32_t length)
{
    fk_check_t check = {0u, 0u};
    for (uint32_t i = 0u; i < length; ++i) {
        if (i < CHECK_AT || i >= TIME_AT) {
            add(&check, log->bytes[place_of(log, offset + i)]);
        }
    }
    return check.sum == log->bytes[place_of(log, offset + CHECK_AT)] &&
           check.sums == log->bytes[place_of(log, offset + CHECK_AT + 1u)];
}

static int32_t is_whole(const fk_log_t *log)
{
    if (log->magic != LOG_MAGIC || log->first >= FK_LOG_BYTES || log->end - log->begin > FK_LOG_BYTES) {
        return 0;
    }
    uint32_t length = 0u;
    for (uint32_t offset = log->begin; offset != log->end; offset += length) {
        length = FK_LOG_HEAD_BYTES + log->bytes[place_of(log, offset)];
        if (length > log->end - offset || !is_record(log, offset, length)) {
            return 0;
        }
    }
    return 1;
}

int32_t fk_log_open(fk_log_t *log)
{
    if (is_whole(log)) {
        return 1;
    }
    clear(log);
    return 0;
}

/* volatile here and below, so that the compiler keeps the order of the stores. Where the oldest record begins is two
 * words; while only one of them is written, the log is none. */
static void drop_oldest(volatile fk_log_t *log, uint32_t begin, uint32_t first)
{
    log->magic = 0u;
    log->begin = begin;
    log->first = first;
    log->magic = LOG_MAGIC;
    ++log->lost;
}

/* A damaged length cannot take `begin` past `end`: more bytes than the longest record are still held when a record
 * is dropped. */
static void make_room(fk_log_t *log, uint32_t bytes)
{
    while (log->end - log->begin > FK_LOG_BYTES - bytes) {
        uint32_t begin = log->begin + FK_LOG_HEAD_BYTES + log->bytes[log->first];
        drop_oldest(log, begin, place_of(log, begin));
    }
}

static void put(volatile fk_log_t *log, uint32_t *place, uint8_t byte)
{
    log->bytes[*place] = byte;
    ++*place;
    *place = (*place < FK_LOG_BYTES) ? *place : 0u;
}

uint32_t fk_log_write(fk_log_t *log, uint8_t id, uint64_t time_us, const uint8_t *content, uint32_t length)
{
    uint8_t head[FK_LOG_HEAD_BYTES] = {(uint8_t)length, id};
    fk_check_t check = {0u, 0u};
    fk_put_u32(head + TIME_AT, (uint32_t)(time_us & 0xFFFFFFFFu));
    fk_put_u16(head + TIME_AT + 4u, (uint16_t)((time_us >> 32) & 0xFFFFu));
    add(&check, head[0]);
    add(&check, head[1]);
    for (uint32_t i = TIME_AT; i < FK_LOG_HEAD_BYTES; ++i) {
        add(&check, head[i]);
    }
    for (uint32_t i = 0u; i < length; ++i) {
        add(&check, content[i]);
    }
    head[CHECK_AT] = check.sum;
    head[CHECK_AT + 1u] = check.sums;

    make_room(log, FK_LOG_HEAD_BYTES + length);
    uint32_t offset = log->end;
    uint32_t place = place_of(log, offset);
    for (uint32_t i = 0u; i < FK_LOG_HEAD_BYTES; ++i) {
        put(log, &place, head[i]);
    }
    for (uint32_t i = 0u; i < length; ++i) {
        put(log, &place, content[i]);
    }
    /* The last store: a reset after make_room() and before it leaves the records before. */
    ((volatile fk_log_t *)log)->end = offset + FK_LOG_HEAD_BYTES + length;
    return offset;
}

void fk_log_finish(fk_log_t *log, uint32_t offset, uint8_t last)
{
    uint32_t length = FK_LOG_HEAD_BYTES + log->bytes[place_of(log, offset)];
    uint8_t *at = &log->bytes[place_of(log, offset + length - 1u)];
    uint8_t *sum = &log->bytes[place_of(log, offset + CHECK_AT)];
    uint8_t *sums = &log->bytes[place_of(log, offset + CHECK_AT + 1u)];
    uint8_t more = (uint8_t)(last - *at); /* the last byte counts once in either sum */
    *sum = (uint8_t)(*sum + more);
    *sums = (uint8_t)(*sums + more);
    *at = last;
}

uint32_t fk_log_read(const fk_log_t *log, uint32_t offset, uint8_t *bytes, uint32_t capacity, uint32_t *from)
{
    if (offset - log->begin > log->end - log->begin) {
        offset = log->begin;
    }
    uint32_t count = (log->end - offset < capacity) ? log->end - offset : capacity;
    for (uint32_t i = 0u; i < count; ++i) {
        bytes[i] = log->bytes[place_of(log, offset + i)];
    }
    *from = offset;
    return count;
}
