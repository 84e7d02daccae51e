// What an axis lets its hub do: profiled moves, braking, and the limits that no command may pass.
//
// The path is calculated in double precision, in the order of operations of the suite's simulator, so that both take
// the same path to the last bit for the same samples. A Cortex-M4F has no hardware for it; a tick takes some thirty
// such operations, about fifty instructions each. Only the root of the profile is taken in single precision, and put
// right by whole numbers.

#ifndef BEAM_CORE_PROFILES_HPP
#define BEAM_CORE_PROFILES_HPP

#include "faults.hpp"
#include "settings.hpp"
#include "text.hpp"

namespace beam {

/// A profiled move ends this close to its target [m]; what rounding leaves is smaller.
constexpr double arrived = 1e-12;

/// The reference that the drive follows: where the hub should be [m] and how it should move [m/s].
struct Motion {
    double position = 0.0;
    double velocity = 0.0;
};

constexpr double magnitude(double value) { return value < 0.0 ? -value : value; }

constexpr double clamped(double value, double low, double high) {
    return value < low ? low : value > high ? high : value;
}

/// Why a command must not be followed.
struct Breach {
    Fault fault = Fault::none;
    Text reason;
};

/// By how much a force will change the hub's speed within a tick, from what the last ones did.
///
/// A device does not know the mass that it moves. The speed goes on changing as it did in the last tick; where the
/// force itself jumps, the jump's share is what earlier jumps taught.
class SpeedForecast {
public:
    /// `tick_speed` is one count per tick [m/s].
    explicit SpeedForecast(double tick_speed) : tick_speed_(tick_speed) {}

    /// Begins anew: no force led the hub to where it is.
    void forget();

    /// Learns another axis.
    void forget_mobility() { mobility_ = 0.0; }

    /// Returns the change [m/s] of the coming tick, at whose beginning the hub has `velocity` [m/s].
    double change(double effort, double velocity, const Limits& limits);

private:
    const double tick_speed_;
    double mobility_ = 0.0;
    bool has_begun_ = false;
    double begun_ = 0.0;
    double changed_ = 0.0;
    double effort_before_ = 0.0;
    double last_effort_ = 0.0;
};

/// The axis's limits with its mode and its tick.
class Profiles {
public:
    Profiles(CommandMode mode, double period) : mode_(mode), period_(period) {}

    /// Returns the velocity [m/s] for the end of the next tick of a time-optimal move that ends at rest on target.
    ///
    /// With u = v/(a T) and D = d/(a T^2), braking from u by one unit a tick covers (n + 1) u - n (n + 1)/2 with
    /// n = floor(u) where the velocity jumps; where it is ramped, the same holds for D - u/2. So
    /// u = D/(n + 1) + n/2 with the n for which n (n + 1)/2 <= D < (n + 1)(n + 2)/2 lands on the target exactly.
    double towards(double distance, double velocity, double speed, double acceleration) const;

    /// Returns the velocity [m/s] for the end of a tick of the stop ramp.
    double braked(double velocity, const Limits& limits) const;

    /// Returns a tick's command on the way to a set-point, in the mode's unit.
    double command_towards(double setpoint, const Motion& motion, const Limits& limits) const;

    /// Whether following a command for a tick would pass a limit, or leave no way to stop within the travel; says
    /// why in `breach`. A force changes the speed by `change` within the tick [m/s].
    bool is_beyond(double command, double change, Motion motion, const Limits& limits, Breach& breach) const;

    /// Whether the velocity runs linearly through a tick; else it jumps at its beginning and stays.
    bool is_ramped() const { return mode_ == CommandMode::acceleration || mode_ == CommandMode::effort; }

private:
    CommandMode mode_;
    double period_;
};

/// The greatest magnitude of a set-point, in the mode's unit.
double command_limit(CommandMode mode, const Limits& limits);

}  // namespace beam

#endif
