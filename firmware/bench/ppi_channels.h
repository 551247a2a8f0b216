/* Who uses which PPI channel (0 to 19 are free for programs). */
#ifndef PPI_CHANNELS_H
#define PPI_CHANNELS_H

#define FK_PPI_UART_COUNT 0u      /* UARTE0 RXDRDY -> TIMER1 COUNT */
#define FK_PPI_PULSE_END_FIRST 1u /* TIMER2 COMPARE[0] -> GPIOTE CLR[limb], one channel for each limb */

#endif
