// A plant instead of pins, on the plant port of docs/firmware.md. Its bytes go through the debugger's channel
// (semihosting), which hands over a whole message at once: QEMU's serial ports take one byte at a time, 30 us each. The
// second USART only rings: a byte there says that a message waits.

#include "../plant/default_rig.hpp"
#include "../plant/plant_port.hpp"
#include "axis.hpp"
#include "hardware_watchdog.hpp"
#include "load.hpp"
#include "registers.hpp"

namespace beam::stm32 {

namespace {

enum class Call : std::uint32_t { open = 1, write = 5, read = 6 };

/// The arguments of a call: what to open and how, or a file, a place in memory and a number of bytes.
struct Arguments {
    std::uint32_t first;
    std::uint32_t second;
    std::uint32_t third;
};

std::uint32_t call_debugger(Call call, const Arguments& arguments) {
    register std::uint32_t r0 asm("r0") = static_cast<std::uint32_t>(call);
    register const Arguments* r1 asm("r1") = &arguments;
    asm volatile("bkpt 0xAB" : "+r"(r0) : "r"(r1) : "memory");
    return r0;
}

std::uint32_t address(const void* place) { return static_cast<std::uint32_t>(reinterpret_cast<std::uintptr_t>(place)); }

constexpr char terminal[] = ":tt";
constexpr std::uint32_t for_reading = 0;
constexpr std::uint32_t for_writing = 4;
constexpr std::size_t chunk = 256;
constexpr std::uint32_t has_byte = 1U << 5U;
/// Enabled, with its sender, its receiver and the interrupt of a received byte.
constexpr std::uint32_t bell = 1U << 13U | 1U << 5U | 1U << 3U | 1U << 2U;

std::uint32_t input = 0;
std::uint32_t output = 0;
PlantPort* plant = nullptr;
std::uint64_t next_tick = 0;

void send() {
    call_debugger(Call::write, {output, address(plant->output()), static_cast<std::uint32_t>(plant->output_size())});
    plant->sent(plant->output_size());
}

/// Takes what the plant has sent by now.
void receive() {
    std::uint8_t data[chunk];
    const std::uint32_t missing = call_debugger(Call::read, {input, address(data), chunk});
    plant->receive(data, chunk - missing);
}

/// Takes what the plant has sent, after a wait for it or for any other interrupt.
void await_bell() {
    // Interrupts are held, so that none comes between the look and the wait; a held one still ends the wait.
    hold_interrupts();
    receive();
    if (!plant->is_set_up() || !plant->has_reading(next_tick)) {
        wait_for_interrupt();
    }
    release_interrupts();
}

}  // namespace

void cut_power() {}

Settings begin_axis(std::uint32_t boot_id) {
    Settings settings = default_rig();
    settings.name = "beam firmware, STM32F405 with a plant";
    static PlantPort the_plant(settings, boot_id);
    plant = &the_plant;
    input = call_debugger(Call::open, {address(terminal), for_reading, sizeof terminal - 1});
    output = call_debugger(Call::open, {address(terminal), for_writing, sizeof terminal - 1});
    usart2().control1 = bell;
    enable_interrupt(usart2_interrupt);
    plant->poll(clock_ns());
    send();
    while (!plant->is_set_up()) {
        feed_watchdog();
        await_bell();
    }
    return plant->settings();
}

void acknowledge() {
    if ((usart2().status & has_byte) != 0) {
        [[maybe_unused]] const std::uint32_t byte = usart2().data;
    }
}

bool has_reading(std::uint64_t tick) {
    const Rest rest;
    if (!plant->has_reading(tick)) {
        receive();
    }
    if (is_paced()) {
        // Without a timer that is due, paced time stands still until the line or the bell has a byte.
        const std::uint32_t running = system_timer().control;
        system_timer().control = 0;
        // Told that all is done until this tick, the plant may answer.
        usart2().data = 0;
        while (!plant->has_reading(tick)) {
            await_bell();
        }
        system_timer().control = running;
    }
    return plant->has_reading(tick);
}

Reading measure() { return plant->reading(); }

void drive(const Drive& drive) {
    const Rest rest;
    next_tick = drive.tick + 1;
    plant->drive(drive, clock_ns());
    send();
}

}  // namespace beam::stm32
