// What runs before the program: the vectors, the memory's first contents, the floating-point unit.

#include <cstdint>

#include "axis.hpp"
#include "registers.hpp"

extern "C" {

extern std::uint32_t stack_top, stack_limit;
extern std::uint32_t data_begin, data_end, data_stored, bss_begin, bss_end;
extern void (*init_begin[])();
extern void (*init_end[])();

[[noreturn]] void reset();
[[noreturn]] void fault();
void on_system_tick();
void on_usart1();
void on_usart2();
}

namespace beam::stm32 {
void run();
}

namespace {

/// What the stack's room holds until it is used.
constexpr std::uint32_t paint = 0xC5C5C5C5;

using Handler = void (*)();

struct Vectors {
    std::uint32_t* stack;
    Handler system[15];
    Handler device[82];
};

constexpr Vectors make_vectors() {
    Vectors vectors{};
    vectors.stack = &stack_top;
    for (Handler& handler : vectors.system) {
        handler = fault;
    }
    for (Handler& handler : vectors.device) {
        handler = fault;
    }
    vectors.system[0] = reset;
    vectors.system[14] = on_system_tick;
    vectors.device[beam::stm32::usart1_interrupt] = on_usart1;
    vectors.device[beam::stm32::usart2_interrupt] = on_usart2;
    return vectors;
}

}  // namespace

extern const Vectors vectors;
[[gnu::section(".vectors"), gnu::used]] constexpr Vectors vectors = make_vectors();

void reset() {
    beam::stm32::cut_power();
    beam::stm32::coprocessor_access() |= 0xFU << 20U;
    asm volatile("dsb\n\tisb" ::: "memory");
    for (std::uint32_t *to = &data_begin, *from = &data_stored; to != &data_end; ++to, ++from) {
        *to = *from;
    }
    for (std::uint32_t* to = &bss_begin; to != &bss_end; ++to) {
        *to = 0;
    }
    auto* const here = static_cast<std::uint32_t*>(__builtin_frame_address(0));
    for (volatile std::uint32_t* to = &stack_limit; to < here - 64; ++to) {
        *to = paint;
    }
    for (auto* initialise = &init_begin[0]; initialise != &init_end[0]; ++initialise) {
        (*initialise)();
    }
    beam::stm32::run();
    fault();
}

/// A processor that has lost its way, its crystal (NMI) or its supply (PVD): the drive loses its current at once, and the
/// hardware watchdog resets the processor, which does nothing more.
void fault() {
    beam::stm32::cut_power();
    beam::stm32::hold_interrupts();
    for (;;) {
    }
}
