// A board whose time is a number: for tests that compare, and for random bytes.

#ifndef BEAM_HOST_VIRTUAL_BOARD_HPP
#define BEAM_HOST_VIRTUAL_BOARD_HPP

#include <cstdint>
#include <string>
#include <vector>

#include "../core/board.hpp"
#include "../plant/ideal_axis.hpp"

namespace beam {

class VirtualBoard final : public Board {
public:
    explicit VirtualBoard(IdealAxis& axis) : axis_(axis) {}

    std::uint64_t clock_ns() override { return now_ns; }
    std::uint32_t boot_id() override { return 5; }
    bool was_reset_by_watchdog() override { return false; }
    std::size_t write(const std::uint8_t* data, std::size_t size) override {
        output.insert(output.end(), data, data + size);
        return size;
    }
    Reading measure() override {
        Reading reading = axis_.measure();
        if (driven.tick < accident_tick || accident.empty()) {
            stuck_at_ = reading.counter;
        } else if (accident == "lost") {
            reading.is_counter_valid = false;
        } else if (accident == "jump") {
            reading.counter += 1'000'000;
        } else if (accident == "stuck") {
            reading.counter = stuck_at_;
        } else if (accident == "end") {
            reading.is_at_low_end = reading.is_at_high_end = true;
        } else if (accident == "alarm") {
            reading.has_drive_alarm = true;
        }
        reading.is_below_home = reading.is_below_home && accident != "blind";
        return reading;
    }
    void drive(const Drive& drive) override {
        axis_.drive(drive);
        driven = drive;
    }
    void feed_watchdog() override {}
    void hold_ticks() override {}
    void release_ticks() override {}

    std::uint64_t now_ns = 0;
    std::vector<std::uint8_t> output;
    Drive driven;
    std::string accident;
    static constexpr std::uint64_t accident_tick = 5000;

private:
    IdealAxis& axis_;
    std::uint32_t stuck_at_ = 0;
};

}  // namespace beam

#endif
