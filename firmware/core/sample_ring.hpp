// The device's buffer for the samples of one sequence.

#ifndef BEAM_CORE_SAMPLE_RING_HPP
#define BEAM_CORE_SAMPLE_RING_HPP

#include <cstdint>

namespace beam {

/// The samples of the present sequence that have come and were not applied yet.
class SampleRing {
public:
    static constexpr std::uint16_t capacity = 2048;

    /// `looks_ahead`: a tick's command is the sample after its own, towards which the hub moves (position mode).
    explicit SampleRing(bool looks_ahead) : ahead_(looks_ahead ? 1 : 0) {}

    void announce(std::uint64_t start_tick, std::uint32_t n_samples) {
        start_tick_ = start_tick;
        n_samples_ = n_samples;
        n_received_ = n_taken_ = 0;
    }

    /// Takes the sample that follows those received; the caller has looked at free() and at n_missing().
    void append(double value) {
        samples_[n_received_ % capacity] = value;
        ++n_received_;
    }

    /// Puts this tick's command in `command`; returns whether it has come.
    bool take(double& command) {
        if (ahead_ != 0 && n_taken_ == 0 && n_received_ != 0) {
            n_taken_ = 1;
        }
        if (n_taken_ == n_received_) {
            return false;
        }
        command = samples_[n_taken_ % capacity];
        ++n_taken_;
        return true;
    }

    /// Throws away what was not applied.
    void clear() { n_taken_ = n_received_; }

    std::uint64_t start_tick() const { return start_tick_; }
    std::uint32_t n_samples() const { return n_samples_; }
    std::uint32_t n_received() const { return n_received_; }
    std::uint32_t n_missing() const { return n_samples_ - n_received_; }
    /// Number of the sample that the next tick needs, counted from 0.
    std::uint32_t awaited() const { return n_taken_ == 0 ? ahead_ : n_taken_; }
    std::uint16_t free() const { return static_cast<std::uint16_t>(capacity - (n_received_ - n_taken_)); }
    /// Whether every sample has been applied.
    bool is_used_up() const { return n_taken_ == n_samples_; }

private:
    double samples_[capacity] = {};
    std::uint64_t start_tick_ = 0;
    std::uint32_t n_samples_ = 0;
    std::uint32_t n_received_ = 0;
    std::uint32_t n_taken_ = 0;
    std::uint32_t ahead_;
};

}  // namespace beam

#endif
