/* What the parts of the stage know of each other: played.c says what it is. */
#ifndef PLAYED_H
#define PLAYED_H

#include "declared.h"

#define NEVER UINT64_MAX

extern uint64_t now_us;

/* @return 1 where the semaphore was given, 0 where the time was over */
int wait_for(struct k_sem *sem, uint64_t until_us);

/* Time goes on while a thread computes, which otherwise takes none. */
void played_spend(uint64_t us);

/* When something happens next, and letting happen what is due now. */
uint64_t played_radio_next_us(void);
void played_radio_event(void);
uint64_t played_gates_next_us(void);
void played_gates_event(void);

#endif
