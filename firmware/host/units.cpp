// What a test of the whole firmware does not see: races with the tick's interrupt, and the numbers of the STM32F405's
// timers. It prints what is wrong, and ends with the number of such lines.

#include <cstdio>
#include <memory>
#include <vector>

#include "../core/core.hpp"
#include "../plant/default_rig.hpp"
#include "../plant/ideal_axis.hpp"
#include "../stm32f405/pulse_train.hpp"
#include "../stm32f405/watchdog_counts.hpp"

namespace {

int n_wrong = 0;

void expect(bool is_so, const char* otherwise, double number = 0.0) {
    if (!is_so) {
        ++n_wrong;
        std::printf("%s (%g)\n", otherwise, number);
    }
}

/// A board whose tick interrupt comes at the last moment before it is kept out.
class RacingBoard final : public beam::Board {
public:
    explicit RacingBoard(const beam::Settings& settings) : axis_(settings, 0.0, 0.8) {}

    std::uint64_t clock_ns() override { return now_ns; }
    std::uint32_t boot_id() override { return 1; }
    bool was_reset_by_watchdog() override { return false; }
    std::size_t write(const std::uint8_t* data, std::size_t size) override {
        output.insert(output.end(), data, data + size);
        return size;
    }
    beam::Reading measure() override { return axis_.measure(); }
    void drive(const beam::Drive& drive) override { axis_.drive(drive); }
    void feed_watchdog() override {}
    void hold_ticks() override {
        if (holds_until_ticks != 0 && --holds_until_ticks == 0) {
            now_ns += ticks_then * 1'000'000;
            while (core->tick()) {
            }
        }
    }
    void release_ticks() override {}

    beam::Core* core = nullptr;
    std::uint64_t now_ns = 0;
    unsigned holds_until_ticks = 0;
    std::uint64_t ticks_then = 0;
    std::vector<std::uint8_t> output;

private:
    beam::IdealAxis axis_;
};

/// Opens a session, lets `waiting` ticks pass without a word, and as many as fill the buffer and 5 more while the core
/// sends: at the given hold.
void race(unsigned at_hold) {
    constexpr std::uint32_t waiting = 30;
    const beam::Settings settings = beam::default_rig();
    RacingBoard board(settings);
    const auto core = std::make_unique<beam::Core>(board, settings);
    board.core = core.get();
    core->start();
    const std::uint8_t hello[] = {0x01, 'B', 'E', 'A', 'M', 2, 2};
    std::uint8_t frame[beam::max_frame];
    core->tick();
    core->receive(frame, beam::encode_frame(hello, sizeof hello, frame), board.now_ns);
    for (std::uint32_t k = 0; k < waiting; ++k) {
        board.now_ns += 1'000'000;
        core->tick();
    }
    board.holds_until_ticks = at_hold;
    board.ticks_then = beam::Telemetry::capacity - waiting + 5;
    core->poll();
    board.holds_until_ticks = 0;
    expect(core->axis().telemetry.size() <= beam::Telemetry::capacity, "more ticks wait than there is room for",
           core->axis().telemetry.size());
}

void check_telemetry() {
    beam::Telemetry telemetry;
    telemetry.add(7, {});
    telemetry.drop(20);
    expect(telemetry.size() == 0, "more was removed than waited", telemetry.size());
    for (unsigned at_hold = 1; at_hold < 5; ++at_hold) {
        race(at_hold);
    }
}

void check_pulses() {
    using namespace beam::stm32;
    for (std::uint32_t period_us : {100U, 500U, 1000U, 1640U, 2000U, 4000U, 10'000U, 99'000U}) {
        const std::uint32_t period_ns = period_us * 1000U;
        const std::uint32_t divisor = pulse_prescaler(period_ns) + 1;
        const double count_ns = 1e9 * divisor / pulse_timer_hz;
        expect(divisor <= most_counts, "the prescaler does not fit its register", period_us);
        for (std::uint32_t steps = 1; steps <= most_steps(period_ns); ++steps) {
            const PulseTrain train = pulse_train(period_ns, steps);
            const double low_ns = train.compare * count_ns;
            const double high_ns = (train.reload + 1 - train.compare) * count_ns;
            expect(train.reload < most_counts, "the spacing does not fit its register", period_us);
            expect(train.repetition == steps - 1 && train.repetition < most_repetitions,
                   "the number of pulses does not fit its register", steps);
            expect(low_ns + count_ns >= direction_setup_ns, "a pulse comes too soon after the direction [ns]", low_ns);
            expect(high_ns + count_ns >= least_pulse_ns, "a pulse is too short [ns]", high_ns);
            expect(steps * (low_ns + high_ns) <= period_ns * 0.8 * (1.0 + 1e-12), "the pulses take more than their part of a tick", steps);
        }
    }
}

void check_watchdog() {
    using namespace beam::stm32;
    for (std::uint32_t period_us : {100U, 1000U, 4000U, 20'000U, 99'000U}) {
        const double shortest_s = static_cast<double>(watchdog_counts(period_us * 1000U)) * watchdog_divisor / fastest_lsi_hz;
        expect(watchdog_counts(period_us * 1000U) <= most_watchdog_counts, "the watchdog's time does not fit", period_us);
        expect(shortest_s >= 2e-6 * period_us, "the watchdog does not wait for two ticks", period_us);
    }
}

}  // namespace

int main() {
    check_telemetry();
    check_pulses();
    check_watchdog();
    return n_wrong;
}
