/* Random bytes from the chip's thermal noise, for the nonces of fk_auth.h. */
#include "fk_auth.h"
#include "nrf52832_regs.h"

/* Reads of the event for one byte, each six cycles at least: 2 ms, where a byte takes 0.12 ms. */
#define READY_READS 20000u

int32_t fk_port_random(uint8_t *bytes, uint32_t count)
{
    uint32_t taken = 0u;
    uint32_t reads = 0u;
    RNG_CONFIG = RNG_CONFIG_DERCEN_Msk; /* without bias */
    RNG_EVENTS_VALRDY = 0u;
    RNG_TASKS_START = 1u;
    while (taken < count && reads < READY_READS) {
        ++reads;
        if (RNG_EVENTS_VALRDY != 0u) {
            RNG_EVENTS_VALRDY = 0u;
            bytes[taken] = (uint8_t)RNG_VALUE;
            ++taken;
            reads = 0u;
        }
    }
    RNG_TASKS_STOP = 1u;
    return (taken == count) ? 0 : -1;
}
