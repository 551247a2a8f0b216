/* Registers of the nRF52832 that this port uses, and no others: nRF52832 Product Specification v1.4, and the
 * ARMv7-M Architecture Reference Manual for the core's own. Names as there. Offsets, fields and values are checked
 * by tests/firmware/test_registers.py against the SVD file that the pyocd wheel carries.
 */
#ifndef NRF52832_REGS_H
#define NRF52832_REGS_H

#include <stdint.h>

#define FK_REGISTER(address) (*(volatile uint32_t *)(uintptr_t)(address))
/* The address of a register as PPI wants it. */
#define FK_ADDRESS_OF(register_) ((uint32_t)(uintptr_t)&(register_))

/* CLOCK */
#define CLOCK_BASE 0x40000000u
#define CLOCK_TASKS_HFCLKSTART FK_REGISTER(CLOCK_BASE + 0x000u)
#define CLOCK_EVENTS_HFCLKSTARTED FK_REGISTER(CLOCK_BASE + 0x100u)

/* POWER: the same block as CLOCK */
#define POWER_BASE 0x40000000u
#define POWER_IRQ 0u
#define POWER_EVENTS_POFWARN FK_REGISTER(POWER_BASE + 0x108u)
#define POWER_INTENSET FK_REGISTER(POWER_BASE + 0x304u)
#define POWER_INTENSET_POFWARN_Msk (1u << 2)
#define POWER_POFCON FK_REGISTER(POWER_BASE + 0x510u)
#define POWER_POFCON_POF_Pos 0u
#define POWER_POFCON_POF_Enabled 1u
#define POWER_POFCON_THRESHOLD_Pos 1u
#define POWER_POFCON_THRESHOLD_V27 14u
#define POWER_RESETREAS FK_REGISTER(POWER_BASE + 0x400u)
#define POWER_RESETREAS_RESETPIN_Msk (1u << 0)
#define POWER_RESETREAS_DOG_Msk (1u << 1)
#define POWER_RESETREAS_SREQ_Msk (1u << 2)
#define POWER_RESETREAS_LOCKUP_Msk (1u << 3)

/* WDT */
#define WDT_BASE 0x40010000u
#define WDT_TASKS_START FK_REGISTER(WDT_BASE + 0x000u)
#define WDT_CRV FK_REGISTER(WDT_BASE + 0x504u)
#define WDT_RREN FK_REGISTER(WDT_BASE + 0x508u)
#define WDT_RREN_RR0_Msk (1u << 0)
#define WDT_CONFIG FK_REGISTER(WDT_BASE + 0x50Cu)
#define WDT_CONFIG_SLEEP_Pos 0u
#define WDT_CONFIG_SLEEP_Run 1u
#define WDT_RR(n) FK_REGISTER(WDT_BASE + 0x600u + 4u * (n))
#define WDT_RR_RR_Reload 0x6E524635u

/* UARTE0. RXDRDY stands in the product specification but not in the SVD's UARTE0; it is at the place where the same
 * block's UART0 has it. */
#define UARTE0_BASE 0x40002000u
#define UARTE0_IRQ 2u
#define UARTE0_TASKS_STARTRX FK_REGISTER(UARTE0_BASE + 0x000u)
#define UARTE0_TASKS_STOPRX FK_REGISTER(UARTE0_BASE + 0x004u)
#define UARTE0_TASKS_STARTTX FK_REGISTER(UARTE0_BASE + 0x008u)
#define UARTE0_EVENTS_RXDRDY FK_REGISTER(UARTE0_BASE + 0x108u)
#define UARTE0_EVENTS_ENDRX FK_REGISTER(UARTE0_BASE + 0x110u)
#define UARTE0_EVENTS_ENDTX FK_REGISTER(UARTE0_BASE + 0x120u)
#define UARTE0_EVENTS_ERROR FK_REGISTER(UARTE0_BASE + 0x124u)
#define UARTE0_EVENTS_RXTO FK_REGISTER(UARTE0_BASE + 0x144u)
#define UARTE0_EVENTS_RXSTARTED FK_REGISTER(UARTE0_BASE + 0x14Cu)
#define UARTE0_SHORTS FK_REGISTER(UARTE0_BASE + 0x200u)
#define UARTE0_SHORTS_ENDRX_STARTRX_Msk (1u << 5)
#define UARTE0_INTENSET FK_REGISTER(UARTE0_BASE + 0x304u)
#define UARTE0_INTENCLR FK_REGISTER(UARTE0_BASE + 0x308u)
#define UARTE0_INTENSET_RXDRDY_Msk (1u << 2)
#define UARTE0_INTENCLR_RXDRDY_Msk (1u << 2)
#define UARTE0_INTENSET_ENDTX_Msk (1u << 8)
#define UARTE0_ERRORSRC FK_REGISTER(UARTE0_BASE + 0x480u)
#define UARTE0_ENABLE FK_REGISTER(UARTE0_BASE + 0x500u)
#define UARTE0_ENABLE_ENABLE_Disabled 0u
#define UARTE0_ENABLE_ENABLE_Enabled 8u
#define UARTE0_PSEL_TXD FK_REGISTER(UARTE0_BASE + 0x50Cu)
#define UARTE0_PSEL_RXD FK_REGISTER(UARTE0_BASE + 0x514u)
#define UARTE0_BAUDRATE FK_REGISTER(UARTE0_BASE + 0x524u)
#define UARTE0_BAUDRATE_BAUDRATE_Baud115200 0x01D60000u
#define UARTE0_RXD_PTR FK_REGISTER(UARTE0_BASE + 0x534u)
#define UARTE0_RXD_MAXCNT FK_REGISTER(UARTE0_BASE + 0x538u)
#define UARTE0_TXD_PTR FK_REGISTER(UARTE0_BASE + 0x544u)
#define UARTE0_TXD_MAXCNT FK_REGISTER(UARTE0_BASE + 0x548u)

/* GPIOTE */
#define GPIOTE_BASE 0x40006000u
#define GPIOTE_TASKS_SET(n) FK_REGISTER(GPIOTE_BASE + 0x030u + 4u * (n))
#define GPIOTE_TASKS_CLR(n) FK_REGISTER(GPIOTE_BASE + 0x060u + 4u * (n))
#define GPIOTE_CONFIG(n) FK_REGISTER(GPIOTE_BASE + 0x510u + 4u * (n))
#define GPIOTE_CONFIG_MODE_Pos 0u
#define GPIOTE_CONFIG_MODE_Task 3u
#define GPIOTE_CONFIG_PSEL_Pos 8u
#define GPIOTE_CONFIG_POLARITY_Pos 16u
#define GPIOTE_CONFIG_POLARITY_None 0u
#define GPIOTE_CONFIG_OUTINIT_Pos 20u
#define GPIOTE_CONFIG_OUTINIT_Low 0u

/* TIMER0 to TIMER2, each with four CC registers */
#define TIMER0_BASE 0x40008000u
#define TIMER0_IRQ 8u
#define TIMER1_BASE 0x40009000u
#define TIMER2_BASE 0x4000A000u
#define TIMER2_IRQ 10u
#define TIMER_TASKS_START(timer) FK_REGISTER((timer) + 0x000u)
#define TIMER_TASKS_STOP(timer) FK_REGISTER((timer) + 0x004u)
#define TIMER_TASKS_COUNT(timer) FK_REGISTER((timer) + 0x008u)
#define TIMER_TASKS_CLEAR(timer) FK_REGISTER((timer) + 0x00Cu)
#define TIMER_TASKS_CAPTURE(timer, n) FK_REGISTER((timer) + 0x040u + 4u * (n))
#define TIMER_EVENTS_COMPARE(timer, n) FK_REGISTER((timer) + 0x140u + 4u * (n))
#define TIMER_SHORTS(timer) FK_REGISTER((timer) + 0x200u)
#define TIMER_SHORTS_COMPARE0_CLEAR_Msk (1u << 0)
#define TIMER_SHORTS_COMPARE0_STOP_Msk (1u << 8)
#define TIMER_INTENSET(timer) FK_REGISTER((timer) + 0x304u)
#define TIMER_INTENSET_COMPARE0_Msk (1u << 16)
#define TIMER_MODE(timer) FK_REGISTER((timer) + 0x504u)
#define TIMER_MODE_MODE_Timer 0u
#define TIMER_MODE_MODE_LowPowerCounter 2u
#define TIMER_BITMODE(timer) FK_REGISTER((timer) + 0x508u)
#define TIMER_BITMODE_BITMODE_32Bit 3u
#define TIMER_PRESCALER(timer) FK_REGISTER((timer) + 0x510u)
#define TIMER_CC(timer, n) FK_REGISTER((timer) + 0x540u + 4u * (n))

/* NVMC */
#define NVMC_BASE 0x4001E000u
#define NVMC_READY FK_REGISTER(NVMC_BASE + 0x400u)
#define NVMC_READY_READY_Busy 0u
#define NVMC_CONFIG FK_REGISTER(NVMC_BASE + 0x504u)
#define NVMC_CONFIG_WEN_Ren 0u
#define NVMC_CONFIG_WEN_Wen 1u
#define NVMC_CONFIG_WEN_Een 2u
#define NVMC_ERASEPAGE FK_REGISTER(NVMC_BASE + 0x508u)
#define NVMC_ICACHECNF FK_REGISTER(NVMC_BASE + 0x540u)
#define NVMC_ICACHECNF_CACHEEN_Msk (1u << 0)

/* PPI */
#define PPI_BASE 0x4001F000u
#define PPI_TASKS_CHG_DIS(n) FK_REGISTER(PPI_BASE + 0x004u + 8u * (n))
#define PPI_CHENSET FK_REGISTER(PPI_BASE + 0x504u)
#define PPI_CHENCLR FK_REGISTER(PPI_BASE + 0x508u)
#define PPI_CH_EEP(n) FK_REGISTER(PPI_BASE + 0x510u + 8u * (n))
#define PPI_CH_TEP(n) FK_REGISTER(PPI_BASE + 0x514u + 8u * (n))
#define PPI_CHG(n) FK_REGISTER(PPI_BASE + 0x800u + 4u * (n))
#define PPI_FORK_TEP(n) FK_REGISTER(PPI_BASE + 0x910u + 4u * (n))

/* P0 */
#define P0_BASE 0x50000000u
#define P0_OUTSET FK_REGISTER(P0_BASE + 0x508u)
#define P0_OUTCLR FK_REGISTER(P0_BASE + 0x50Cu)
#define P0_PIN_CNF(n) FK_REGISTER(P0_BASE + 0x700u + 4u * (n))
#define P0_PIN_CNF_DIR_Pos 0u
#define P0_PIN_CNF_DIR_Input 0u
#define P0_PIN_CNF_DIR_Output 1u
#define P0_PIN_CNF_INPUT_Pos 1u
#define P0_PIN_CNF_INPUT_Connect 0u
#define P0_PIN_CNF_INPUT_Disconnect 1u
#define P0_PIN_CNF_PULL_Pos 2u
#define P0_PIN_CNF_PULL_Disabled 0u
#define P0_PIN_CNF_PULL_Pullup 3u

/* The core's own (ARMv7-M ARM, B3.2) */
#define NVIC_ICPR0 FK_REGISTER(0xE000E280u)
#define SCB_SCR FK_REGISTER(0xE000ED10u)
#define SCB_SCR_SEVONPEND_Msk (1u << 4)
#define SCB_CPACR FK_REGISTER(0xE000ED88u)
#define SCB_CPACR_CP10_CP11_Full (0xFu << 20)

#endif
