/* Tests only: what an onlooker with a clock sees of a robot. */
#ifndef PLAY_H
#define PLAY_H

#include <stdint.h>

enum { /* what is seen; the same numbers as in onlooker.py */
    SEEN_POWER_ON = 0,
    SEEN_RESET = 1,
    SEEN_ARM = 2,
    SEEN_DISARM = 3,
    SEEN_STOP = 4,
    SEEN_STARTED = 5,
    SEEN_ENDED = 6,
    SEEN_FIX = 7,
    SEEN_HIGH = 8,
    SEEN_LOW = 9,
    SEEN_STATE = 10,
    SEEN_FAULT = 11
};

typedef struct {
    int64_t time_us;
    int32_t kind;
    int32_t value; /* limb, state */
} seen_t;

#endif
