// An axis that follows its reference exactly and carries a rigid mass: what stands behind a board without a plant.

#ifndef BEAM_PLANT_IDEAL_AXIS_HPP
#define BEAM_PLANT_IDEAL_AXIS_HPP

#include <cstdint>

#include "../core/board.hpp"
#include "../core/settings.hpp"

namespace beam {

class IdealAxis {
public:
    /// `position`: where the hub stands at the start, seen from its home [m].
    IdealAxis(const Settings& settings, double position, double mass)
        : period_(settings.period_ns * 1e-9),
          resolution_(settings.encoder_resolution),
          mass_(mass),
          start_(position),
          position_(position) {}

    Reading measure() const {
        Reading reading;
        reading.counter = counter(position_ - start_);
        reading.home_counter = counter(-start_);
        reading.has_home_counter = true;
        reading.is_below_home = position_ < 0.0;
        reading.effort = static_cast<float>(effort_);
        return reading;
    }

    void drive(const Drive& drive) {
        if (drive.is_free) {
            const double acceleration = drive.effort / mass_;
            position_ += (velocity_ + acceleration * (period_ * 0.5)) * period_;
            velocity_ += acceleration * period_;
            effort_ = drive.effort;
            return;
        }
        const double before = velocity_;
        position_ += (drive.velocity + drive.acceleration * (period_ * 0.5)) * period_;
        velocity_ = drive.velocity + drive.acceleration * period_;
        effort_ = mass_ * (velocity_ - before) / period_;
    }

    double position() const { return position_; }

private:
    std::uint32_t counter(double way) const {
        const double counts = way / resolution_;
        return static_cast<std::uint32_t>(static_cast<std::int64_t>(counts < 0.0 ? counts - 0.5 : counts + 0.5));
    }

    double period_;
    double resolution_;
    double mass_;
    double start_;
    double position_;
    double velocity_ = 0.0;
    double effort_ = 0.0;
};

}  // namespace beam

#endif
