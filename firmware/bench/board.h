/* Pins and limits of the board, in one place. Pins of port P0 as on Nordic's nRF52 development kit (PCA10040). */
#ifndef BOARD_H
#define BOARD_H

#include <stdint.h>

/* The kit's debugger passes this UART on as a virtual serial port. */
#define FK_BOARD_UART_TX_PIN 6u
#define FK_BOARD_UART_RX_PIN 8u

/* Gates of the limbs' MOSFETs, high = heating, in the order of the robot's limbs: front right, front left,
 * rear left, rear right. Arduino header D10 to D13: no LED or button of the kit hangs there. */
#define FK_BOARD_LIMBS 4u
#define FK_BOARD_LIMB_PINS {22u, 23u, 24u, 25u}

/* The longest pulse that the port starts, whatever it is asked for: an SMA limb burns when it is heated on. */
#define FK_BOARD_PULSE_MAX_US 100000u

#endif
