// The firmware on an STM32F405: the core, ticks by the system timer's interrupt, the host's line on the first USART.

#include "../core/core.hpp"
#include "axis.hpp"
#include "clock.hpp"
#include "hardware_watchdog.hpp"
#include "load.hpp"
#include "registers.hpp"
#include "serial_port.hpp"

extern "C" std::uint32_t starts;

namespace beam::stm32 {

Load load;

namespace {

constexpr std::uint32_t baud = 921'600;
constexpr std::size_t chunk = 256;
constexpr std::uint32_t watchdog_reset = 1U << 29U;
constexpr std::uint32_t forget_resets = 1U << 24U;
constexpr std::uint32_t random_patience = 10'000;

static_assert(watchdog_counts(99'000'000) <= most_watchdog_counts, "the longest tick must fit the watchdog");

SerialPort line(usart1());

/// Returns another number after every start: starts are counted where a reset leaves them, and drawn from noise.
std::uint32_t draw_boot_id() {
    rcc().ahb2_enable |= 1U << 6U;
    random_generator().control = 1U << 2U;
    std::uint32_t drawn = 0;
    for (std::uint32_t i = 0; i < random_patience; ++i) {
        if ((random_generator().status & 1U) != 0) {
            drawn = random_generator().data;
            break;
        }
    }
    starts = starts + 1;
    return starts ^ drawn;
}

class Stm32Board final : public Board {
public:
    Stm32Board() : boot_id_(draw_boot_id()), was_reset_by_watchdog_((rcc().status & watchdog_reset) != 0) {
        rcc().status |= forget_resets;
    }

    std::uint64_t clock_ns() override { return stm32::clock_ns(); }
    std::uint32_t boot_id() override { return boot_id_; }
    bool was_reset_by_watchdog() override { return was_reset_by_watchdog_; }
    std::size_t write(const std::uint8_t* data, std::size_t size) override { return line.write(data, size); }
    Reading measure() override { return stm32::measure(); }
    void drive(const Drive& drive) override { stm32::drive(drive); }
    void feed_watchdog() override { stm32::feed_watchdog(); }
    void hold_ticks() override { mask_from(axis_priority); }
    void release_ticks() override { mask_from(0); }

private:
    std::uint32_t boot_id_;
    bool was_reset_by_watchdog_;
};

Core* core = nullptr;

std::uint32_t period_ns = 0;

volatile bool is_ticking = false;

/// Does the ticks that are due and whose readings have come; an interrupt that finds them under way leaves them alone.
void do_ticks() {
    if (core == nullptr || is_ticking) {
        return;
    }
    is_ticking = true;
    while (clock_ns() >= core->next_tick() * period_ns && has_reading(core->next_tick())) {
        load.begin_tick();
        core->tick();
        load.end_tick();
    }
    is_ticking = false;
}

void begin_line() {
    rcc().ahb1_enable |= 1U;
    rcc().apb2_enable |= 1U << 4U;
    // PA9 and PA10, alternate function 7.
    port('A').mode |= 2U << 18U | 2U << 20U;
    port('A').alternate[1] |= 7U << 4U | 7U << 8U;
    line.begin(apb2_hz, baud);
    enable_interrupt(usart1_interrupt);
}

}  // namespace

/// What startup.cpp calls. It returns only where clocks or supply are not what they must be: then nothing moves, nobody is
/// answered, and the watchdog soon tries again.
void run() {
    begin_watchdog(least_watchdog_counts);
    set_priorities();
    if (!begin_supply_watch() || !begin_clocks()) {
        return;
    }
    static Stm32Board board;
    const Settings settings = begin_axis(board.boot_id());
    static Core the_core(board, settings);
    begin_line();
    period_ns = settings.period_ns;
    the_core.start();
    core = &the_core;
    begin_watchdog(watchdog_counts(period_ns));
    if (!begin_ticks(settings.period_ns)) {
        return;
    }
    while (true) {
        hold_interrupts();
        if (!line.has_received()) {
            const Rest rest;
            wait_for_interrupt();
        }
        release_interrupts();
        std::uint8_t data[chunk];
        std::uint64_t begun_ns = 0;
        std::size_t size = 0;
        while ((size = line.read(data, sizeof data, begun_ns)) != 0) {
            core->receive(data, size, begun_ns);
        }
        core->poll();
    }
}

}  // namespace beam::stm32

extern "C" {

void on_system_tick() {
    beam::stm32::do_ticks();
}

void on_usart1() { beam::stm32::line.on_interrupt(); }

void on_usart2() {
    beam::stm32::acknowledge();
    beam::stm32::do_ticks();
}
}
