// The encoder: a free-running hardware counter of 16 or 32 bits, counted on without end.

#ifndef BEAM_CORE_ENCODER_HPP
#define BEAM_CORE_ENCODER_HPP

#include <cstdint>

namespace beam {

class Encoder {
public:
    explicit Encoder(std::uint8_t counter_bits) : shift_(32U - counter_bits) {}

    /// Begins at a counter's value: count 0.
    void start(std::uint32_t counter) { last_ = counter; }

    /// Takes the counter's value at a tick; the hub has moved less than half the counter's range since the last one.
    void update(std::uint32_t counter) {
        step_ = distance(counter, last_);
        count_ += step_;
        last_ = counter;
    }

    /// Returns the count that belongs to a counter's value of the recent past.
    std::int64_t count_of(std::uint32_t counter) const { return count_ + distance(counter, last_); }

    /// Counts since the start.
    std::int64_t count() const { return count_; }
    /// Counts of the last tick.
    std::int32_t step() const { return step_; }

private:
    std::int32_t distance(std::uint32_t to, std::uint32_t from) const {
        return static_cast<std::int32_t>((to - from) << shift_) >> shift_;
    }

    std::uint32_t shift_;
    std::uint32_t last_ = 0;
    std::int32_t step_ = 0;
    std::int64_t count_ = 0;
};

}  // namespace beam

#endif
