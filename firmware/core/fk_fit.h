/* Whether a table is for this robot and within the guard's limits. */
#ifndef FK_FIT_H
#define FK_FIT_H

#include <stdint.h>

#include "fk_planner.h"

#define FK_STROKE_GAP_US 1000u /* from a pulse's end until the port's one pulse timer is free for the next */

/* What any search on the chip ends within, whatever the table. The bench's watchdog may reset it after 960 ms, where its
 * oscillator is 2 % fast; a turn of the loop may wait 23 ms for the UART, and does all else in less than the rest. */
#define FK_SEARCH_MOST_US 925000u
/* The longest path through the machine code that zig makes of the planner, whatever the table, state, path and settings:
 * host/frogkick/front/plan_time.py finds it, tests/firmware/test_plan_time.py holds these numbers against it. */
#define FK_SEARCH_FIXED_US 2000u     /* of a plan, beside its search's transitions and nodes */
#define FK_TRANSITION_MOST_NS 68000u /* a transition, whichever the cost */
#define FK_NODE_MOST_NS 39500u       /* a node that is opened: its velocity is predicted and looked up, its sine and cosine */
/* A look-up visits every leaf and every state of the search tree where they are all alike, or lie on a sphere around what
 * is looked up: for each leaf, and for each pair of states that is read. */
#define FK_LEAF_MOST_NS 2380u
#define FK_PAIR_MOST_NS 1380u
/* Look-ups beside those that a search's transitions pay for, in one turn of the port's loop: for a fix at most 21 (9 for
 * the action before it and 8 for the time since, 1 to begin anew, 3 to reset the pose), of the search its root and at
 * most three nodes that are not finished when it is ended, and as many as periods of rest fit between fix and decision. */
#define FK_LOOK_UPS_BESIDE 25u
#define FK_LOOK_UPS_WITHIN_US 500000u /* the oldest fix that a decision takes */
#define FK_LOOK_UPS_WITHIN_MAX 8u     /* after more periods of rest the estimator forgets */

/* Open an image, every byte of it checked, and check that it is for this robot and within the guard's limits.
 * @retval 0         tables filled
 * @retval negative  fk_error_t of fk_tables_open, FK_ERROR_ROBOT where the image is for another robot,
 *                   FK_ERROR_IMAGE_TIMES where its pulse is above the guard's limit, or a whole stroke longer than
 *                   the period; FK_ERROR_IMAGE_COUNT where its states are so many that the first level of a search may
 *                   not end before the watchdog resets the chip
 */
int32_t fk_fit_open(const uint8_t *image, uint32_t image_bytes, fk_tables_t *tables);

/* From the first pulse's start until the pulse timer is free after the second. */
uint64_t fk_fit_stroke_us(const fk_tables_t *tables);

/* Transitions after which any search in this table has ended within FK_SEARCH_MOST_US. Of a node that a search opens
 * all actions are evaluated, so each transition pays for its share of one look-up. It takes up to 2 ms itself. */
uint32_t fk_fit_transitions(const fk_tables_t *tables);

#endif
