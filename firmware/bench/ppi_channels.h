/* Who uses which PPI channel and group (channels 0 to 19 and groups 0 to 5 are free for programs). */
#ifndef PPI_CHANNELS_H
#define PPI_CHANNELS_H

#define FK_PPI_UART_COUNT 0u        /* UARTE0 RXDRDY -> TIMER1 COUNT */
#define FK_PPI_PULSE_END_FIRST 1u   /* TIMER2 COMPARE[0] -> GPIOTE CLR[limb], one channel for each of eight limbs */
#define FK_PPI_PULSE_BEGIN_FIRST 9u /* TIMER2 COMPARE[1] -> GPIOTE SET[limb], one channel for each of eight limbs */
#define FK_PPI_PULSE_START 17u      /* TIMER0 COMPARE[2] -> TIMER2 START, and the group's DIS: once */
#define FK_PPI_GROUP_PULSE_START 0u /* that channel alone */

/* The channels by which a pulse begins, of all eight limbs. */
#define FK_PPI_PULSE_BEGIN_MASK ((1u << FK_PPI_PULSE_START) | (0xFFu << FK_PPI_PULSE_BEGIN_FIRST))

#endif
