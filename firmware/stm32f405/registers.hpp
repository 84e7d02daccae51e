// The registers of the STM32F405 that this target uses, after ST's reference manual RM0090 and Arm's v7-M manual.

#ifndef BEAM_STM32F405_REGISTERS_HPP
#define BEAM_STM32F405_REGISTERS_HPP

#include <cstdint>

namespace beam::stm32 {

using Register = volatile std::uint32_t;

/// Reset and clock control (RM0090 section 7.3).
struct ResetClockControl {
    Register control, pll, configuration, interrupts;
    Register ahb1_reset, ahb2_reset, ahb3_reset, reserved0;
    Register apb1_reset, apb2_reset, reserved1[2];
    Register ahb1_enable, ahb2_enable, ahb3_enable, reserved2;
    Register apb1_enable, apb2_enable, reserved3[2];
    Register ahb1_sleep, ahb2_sleep, ahb3_sleep, reserved4;
    Register apb1_sleep, apb2_sleep, reserved5[2];
    Register backup, status;
};

/// Power control (section 5.4).
struct PowerControl {
    Register control, status;
};

/// External interrupts (section 12.3).
struct ExternalInterrupts {
    Register mask, event_mask, rising, falling, software, pending;
};

/// A port of 16 pins (section 8.4).
struct Port {
    Register mode, output_type, speed, pull, input, output, set_reset, lock, alternate[2];
};

/// A timer; only an advanced one has all of these (sections 17.4 and 18.4).
struct Timer {
    Register control1, control2, slave, interrupts, status, events;
    Register capture_mode[2], capture_enable, count, prescaler, reload, repetition, capture[4], break_dead;
};

/// A serial port (section 30.6).
struct SerialRegisters {
    Register status, data, baud, control1, control2, control3;
};

/// The independent watchdog (section 21.4).
struct WatchdogRegisters {
    Register key, prescaler, reload, status;
};

/// The random number generator (section 24.4).
struct RandomGenerator {
    Register control, status, data;
};

/// The core's tick timer (v7-M manual, B3.3).
struct SystemTimer {
    Register control, reload, count;
};

template <typename Registers>
Registers& at(std::uint32_t address) {
    return *reinterpret_cast<Registers*>(address);
}

inline ResetClockControl& rcc() { return at<ResetClockControl>(0x40023800); }
inline PowerControl& power() { return at<PowerControl>(0x40007000); }
inline ExternalInterrupts& external_interrupts() { return at<ExternalInterrupts>(0x40013C00); }
inline Register& flash_access() { return at<Register>(0x40023C00); }
inline Port& port(char name) { return at<Port>(0x40020000U + 0x400U * static_cast<std::uint32_t>(name - 'A')); }
inline Timer& timer1() { return at<Timer>(0x40010000); }
inline Timer& timer2() { return at<Timer>(0x40000000); }
inline Timer& timer3() { return at<Timer>(0x40000400); }
inline SerialRegisters& usart1() { return at<SerialRegisters>(0x40011000); }
inline SerialRegisters& usart2() { return at<SerialRegisters>(0x40004400); }
inline WatchdogRegisters& watchdog() { return at<WatchdogRegisters>(0x40003000); }
inline RandomGenerator& random_generator() { return at<RandomGenerator>(0x50060800); }
inline SystemTimer& system_timer() { return at<SystemTimer>(0xE000E010); }
inline Register& coprocessor_access() { return at<Register>(0xE000ED88); }

constexpr unsigned usart1_interrupt = 37;
constexpr unsigned usart2_interrupt = 38;

/// Priorities: the host's line goes before the tick, so that a long tick loses no byte; so does a plant that is waited for.
constexpr std::uint8_t line_priority = 0x40;
constexpr std::uint8_t axis_priority = 0x60;
constexpr std::uint8_t tick_priority = 0x80;

inline void set_priorities() {
    at<volatile std::uint8_t>(0xE000E400U + usart1_interrupt) = line_priority;
    at<volatile std::uint8_t>(0xE000E400U + usart2_interrupt) = axis_priority;
    at<volatile std::uint8_t>(0xE000ED23U) = tick_priority;
}

inline void enable_interrupt(unsigned number) { at<Register>(0xE000E100U + number / 32 * 4) = 1U << (number % 32); }

inline void wait_for_interrupt() { asm volatile("dsb\n\twfi\n\tisb" ::: "memory"); }
inline void hold_interrupts() { asm volatile("cpsid i" ::: "memory"); }
inline void release_interrupts() { asm volatile("cpsie i" ::: "memory"); }

/// Keeps interrupts of the tick's priority and below out; 0 lets all in.
inline void mask_from(std::uint32_t priority) { asm volatile("msr basepri, %0\n\tisb" ::"r"(priority) : "memory"); }

/// Keeps all interrupts out for as long as it lives.
class Exclusive {
public:
    Exclusive() {
        asm volatile("mrs %0, primask\n\tcpsid i" : "=r"(mask_)::"memory");
    }
    ~Exclusive() { asm volatile("msr primask, %0" ::"r"(mask_) : "memory"); }
    Exclusive(const Exclusive&) = delete;
    Exclusive& operator=(const Exclusive&) = delete;

private:
    std::uint32_t mask_;
};

}  // namespace beam::stm32

#endif
