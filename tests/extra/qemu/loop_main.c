/* Lives through a parity scenario's turns of the core and prints what comes of each: outputs as words, the number of bytes
 * sent, and these bytes, four to a word. */
#include <stdint.h>

#include "calls.h"
#include "fk_robot_state.h"
#include "fk_table.h"
#include "startup.h"

#define STREAM_BYTES 1024u

int main(void);

static fk_robot_t robot;
static const fk_guard_persistent_t cold = {FK_COLD_LIMBS};
static fk_guard_persistent_t kept;
static uint8_t stream[STREAM_BYTES];

static void print_stream(uint32_t length)
{
    for (uint32_t at = 0u; at < length; at += 4u) {
        uint32_t word = 0u;
        for (uint32_t byte = 0u; byte < 4u && at + byte < length; ++byte) {
            word |= (uint32_t)stream[at + byte] << (8u * byte);
        }
        fk_put_word(word, ' ');
    }
}

int main(void)
{
    const int32_t error = fk_robot_init(&robot, fk_table_image, fk_table_image_bytes);

    if (error != FK_OK) {
        fk_put_text("refused ");
        fk_put_word((uint32_t)error, '\n');
        return 1;
    }
    kept = cold; /* as the scenario's robot begins */
    fk_robot_note_reset(&robot, FK_RESET_POWER, &kept);
    for (uint32_t index = 0u; index < FK_CALLS; ++index) {
        const uint64_t now_us = fk_call_times_us[index];
        fk_outputs_t outputs;
        uint32_t length;

        if (fk_call_lengths[index] > 0u) {
            fk_robot_on_frame(&robot, &fk_call_frames[fk_call_offsets[index]], fk_call_lengths[index], now_us);
        }
        fk_robot_tick(&robot, now_us, &outputs);
        fk_put_word(outputs.limb_mask, ' ');
        fk_put_word(outputs.all_off, ' ');
        fk_put_word(outputs.pulse_us, ' ');
        fk_put_word((uint32_t)outputs.next_tick_us, ' ');
        fk_put_word((uint32_t)(outputs.next_tick_us >> 32), ' ');
        do {
            length = fk_robot_take_tx(&robot, stream, STREAM_BYTES);
            fk_put_word(length, ' ');
            print_stream(length);
        } while (length > 0u);
        fk_put_text("\n");
    }
    fk_put_text("done\n");
    return 0;
}
