/* Pins and limits of the board, in one place. Pins of port P0 as on Nordic's nRF52 development kit (PCA10040). */
#ifndef BOARD_H
#define BOARD_H

#include <stdint.h>

/* The kit's debugger passes this UART on as a virtual serial port. */
#define FK_BOARD_UART_TX_PIN 6u
#define FK_BOARD_UART_RX_PIN 8u

/* Gates of the limbs' MOSFETs, high = heating, in the order of the robot's limbs: Arduino header D10 to D13, then A2
 * to A5. No LED or button of the kit hangs there. Each needs a channel of GPIOTE, of which the chip has eight. */
#define FK_BOARD_LIMBS_MAX 8u
#define FK_BOARD_LIMB_PINS {22u, 23u, 24u, 25u, 28u, 29u, 30u, 31u}

/* Limbs that are wired, the first FK_BOARD_LIMBS of these pins; the others are left alone. A build for a robot with another
 * number says -DFK_BOARD_LIMBS=6u, as 'frogkick firmware build' does from the robot's table. */
#ifndef FK_BOARD_LIMBS
#define FK_BOARD_LIMBS 4u
#endif
typedef char fk_board_limbs_fit[(FK_BOARD_LIMBS >= 1u && FK_BOARD_LIMBS <= FK_BOARD_LIMBS_MAX) ? 1 : -1];

/* Below this supply of the chip nothing is heated: a value of POFCON.THRESHOLD, 14 = 2.7 V (15 = 2.8 V is the
 * highest). The kit runs at 3.0 V. */
#ifndef FK_BOARD_SUPPLY_LEAST
#define FK_BOARD_SUPPLY_LEAST POWER_POFCON_THRESHOLD_V27
#endif

/* The longest pulse that the port starts, whatever it is asked for: an SMA limb burns when it is heated on. */
#define FK_BOARD_PULSE_MAX_US 100000u

#endif
