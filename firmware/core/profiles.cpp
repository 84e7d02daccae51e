#include "profiles.hpp"

#include <cmath>

namespace beam {

namespace {

/// Relative slack of the device's own limits over the host's, so that a checked sequence never trips them.
constexpr double slack = 1e-5;

/// The hub's mobility is learned from a change of the force by at least this share of the greatest ...
constexpr double least_jump = 0.1;

/// ... which changes the speed by at least so many counts per tick more than the tick before did.
constexpr double least_counts = 16.0;

/// Returns the n for which n (n + 1)/2 <= size < (n + 1)(n + 2)/2.
double whole_ticks(double size) {
    const float root = std::sqrt(1.0F + 8.0F * static_cast<float>(size));
    double n = static_cast<double>(static_cast<std::int64_t>((root - 1.0F) * 0.5F));
    while (n > 0.0 && n * (n + 1.0) * 0.5 > size) {
        n -= 1.0;
    }
    while ((n + 1.0) * (n + 2.0) * 0.5 <= size) {
        n += 1.0;
    }
    return n;
}

}  // namespace

void SpeedForecast::forget() {
    has_begun_ = false;
    changed_ = effort_before_ = last_effort_ = 0.0;
}

double SpeedForecast::change(double effort, double velocity, const Limits& limits) {
    if (has_begun_) {
        const double changed = velocity - begun_;
        const double jump = magnitude(last_effort_ - effort_before_);
        const double answer = magnitude(changed - changed_);
        if (jump >= least_jump * limits.max_effort && answer >= least_counts * tick_speed_ &&
            answer > mobility_ * jump) {
            mobility_ = answer / jump;
        }
        changed_ = changed;
    }
    has_begun_ = true;
    begun_ = velocity;
    effort_before_ = last_effort_;
    last_effort_ = effort;
    return changed_ + mobility_ * (effort - effort_before_);
}

double Profiles::towards(double distance, double velocity, double speed, double acceleration) const {
    const double unit = acceleration * period_;
    const double way = distance / (unit * period_) - (is_ramped() ? velocity / (2.0 * unit) : 0.0);
    // Further away than this the speed decides, not the braking; the root stays within its precision.
    const double size = clamped(magnitude(way), 0.0, 1e12);
    const double n = whole_ticks(size);
    double wanted = (size / (n + 1.0) + n * 0.5) * unit;
    if (way < 0.0) {
        wanted = -wanted;
    }
    wanted = clamped(wanted, -speed, speed);
    return clamped(wanted, velocity - unit, velocity + unit);
}

double Profiles::braked(double velocity, const Limits& limits) const {
    const double step = limits.stop_deceleration * period_;
    if (magnitude(velocity) <= step) {
        return 0.0;
    }
    return velocity < 0.0 ? velocity + step : velocity - step;
}

double Profiles::command_towards(double setpoint, const Motion& motion, const Limits& limits) const {
    if (mode_ == CommandMode::velocity) {
        const double step = limits.max_acceleration * period_;
        return clamped(setpoint, motion.velocity - step, motion.velocity + step);
    }
    if (mode_ != CommandMode::position) {
        return setpoint;
    }
    // Position commands name the end of the tick, as the samples of a sequence do.
    const double distance = setpoint - motion.position;
    const double velocity = towards(distance, motion.velocity, limits.move_speed, limits.move_acceleration);
    if (magnitude(distance - velocity * period_) < arrived) {
        return setpoint;
    }
    return motion.position + velocity * period_;
}

bool Profiles::is_beyond(double command, double change, Motion motion, const Limits& limits, Breach& breach) const {
    if (!std::isfinite(command)) {
        breach = {Fault::command_not_finite, Text("limit: command ") << command};
        return true;
    }
    double acceleration = 0.0;
    const double begun = motion.velocity;
    switch (mode_) {
    case CommandMode::acceleration:
        acceleration = command;
        motion.velocity = begun + command * period_;
        motion.position += (begun + motion.velocity) * (period_ * 0.5);
        break;
    case CommandMode::velocity:
        acceleration = (command - begun) / period_;
        motion.velocity = command;
        motion.position += command * period_;
        break;
    case CommandMode::position:
        motion.velocity = (command - motion.position) / period_;
        acceleration = (motion.velocity - begun) / period_;
        motion.position = command;
        break;
    case CommandMode::effort:
        if (magnitude(command) > limits.max_effort * (1.0 + slack)) {
            breach = {Fault::effort_limit,
                      Text("limit: effort ") << command << " N beyond " << limits.max_effort << " N"};
            return true;
        }
        motion.velocity = begun + change;
        motion.position += (begun + motion.velocity) * (period_ * 0.5);
        break;
    }
    if (magnitude(acceleration) > limits.max_acceleration * (1.0 + slack)) {
        breach = {Fault::acceleration_limit, Text("limit: acceleration ")
                                                 << acceleration << " m/s^2 beyond " << limits.max_acceleration
                                                 << " m/s^2"};
        return true;
    }
    if (magnitude(motion.velocity) > limits.max_speed * (1.0 + slack)) {
        breach = {Fault::speed_limit, Text("limit: speed ") << motion.velocity << " m/s beyond "
                                                            << limits.max_speed << " m/s"};
        return true;
    }
    const double braking =
        motion.velocity * magnitude(motion.velocity) / (2.0 * limits.stop_deceleration);
    const double room =
        limits.travel * 0.5 + limits.stop_deceleration * period_ * period_ + slack * limits.travel;
    if (magnitude(motion.position) > room || magnitude(motion.position + braking) > room) {
        breach = {Fault::travel_limit, Text("limit: at ")
                                           << motion.position << " m with " << motion.velocity
                                           << " m/s the hub can just be stopped within +-"
                                           << limits.travel * 0.5 << " m"};
        return true;
    }
    return false;
}

double command_limit(CommandMode mode, const Limits& limits) {
    switch (mode) {
    case CommandMode::acceleration:
        return limits.max_acceleration;
    case CommandMode::velocity:
        return limits.max_speed;
    case CommandMode::position:
        return limits.travel * 0.5;
    case CommandMode::effort:
        break;
    }
    return limits.max_effort;
}

}  // namespace beam
