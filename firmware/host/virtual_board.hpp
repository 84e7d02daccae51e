// A board whose time is a number: for tests that compare, and for random bytes.

#ifndef BEAM_HOST_VIRTUAL_BOARD_HPP
#define BEAM_HOST_VIRTUAL_BOARD_HPP

#include <cstdint>
#include <vector>

#include "../core/board.hpp"
#include "../plant/ideal_axis.hpp"
#include "../plant/plant_port.hpp"

namespace beam {

/// What somebody does to the axis by hand: signals held on or off (the flags of a reading), a hub that is stuck, a
/// counter that is wrong.
struct Interference {
    std::uint8_t on = 0;
    std::uint8_t off = 0;
    std::uint8_t is_stuck = 0;
    std::int32_t counts = 0;
};

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
        reading.counter += static_cast<std::uint32_t>(interference.counts);
        const unsigned flags = (flags_of(reading) | interference.on) & ~static_cast<unsigned>(interference.off);
        set_flags(reading, static_cast<std::uint8_t>(flags));
        return reading;
    }
    void drive(const Drive& drive) override {
        if (interference.is_stuck == 0) {
            axis_.drive(drive);
        }
        driven = drive;
    }
    void feed_watchdog() override {}
    void hold_ticks() override {}
    void release_ticks() override {}

    std::uint64_t now_ns = 0;
    std::vector<std::uint8_t> output;
    Drive driven;
    Interference interference;

private:
    IdealAxis& axis_;
};

}  // namespace beam

#endif
