// What the axis did and measured tick by tick, until a batch is full.

#ifndef BEAM_CORE_TELEMETRY_HPP
#define BEAM_CORE_TELEMETRY_HPP

#include <cstdint>

namespace beam {

struct Sample {
    double applied = 0.0;
    std::int32_t position = 0;
    std::int32_t velocity = 0;
    float effort = 0.0F;
};

/// Consecutive ticks that wait to be sent.
class Telemetry {
public:
    static constexpr std::uint32_t capacity = 256;

    /// Takes the sample of the tick that follows; where there is no room, what waits is lost.
    void add(std::uint64_t tick, const Sample& sample) {
        if (size_ == capacity) {
            size_ = 0;
        }
        if (size_ == 0) {
            first_tick_ = tick;
        }
        samples_[(first_tick_ + size_) % capacity] = sample;
        ++size_;
    }

    void clear() { size_ = 0; }

    /// Removes the oldest samples, at most all that wait.
    void drop(std::uint32_t n) {
        n = n < size_ ? n : size_;
        first_tick_ += n;
        size_ -= n;
    }

    const Sample& operator[](std::uint32_t k) const { return samples_[(first_tick_ + k) % capacity]; }
    std::uint64_t first_tick() const { return first_tick_; }
    std::uint32_t size() const { return size_; }

private:
    Sample samples_[capacity];
    std::uint64_t first_tick_ = 0;
    std::uint32_t size_ = 0;
};

}  // namespace beam

#endif
