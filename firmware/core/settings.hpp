// What an axis is: its tick, its encoder, its drive, and the widest limits that a host can give it.

#ifndef BEAM_CORE_SETTINGS_HPP
#define BEAM_CORE_SETTINGS_HPP

#include <cstdint>

namespace beam {

/// What set-points and samples mean; the numbers are those of the line protocol.
enum class CommandMode : std::uint8_t { acceleration, velocity, position, effort };

/// What an axis keeps by itself, in the order of the line protocol; all zero: no limits yet.
struct Limits {
    double travel = 0.0;               ///< whole travel, home in its middle [m]
    double max_speed = 0.0;            ///< [m/s]
    double max_acceleration = 0.0;     ///< [m/s^2]
    double max_effort = 0.0;           ///< [N]
    double stop_deceleration = 0.0;    ///< of the stop ramp [m/s^2]
    double move_speed = 0.0;           ///< of the move to a position set-point [m/s]
    double move_acceleration = 0.0;    ///< [m/s^2]
    double homing_speed = 0.0;         ///< of the way home [m/s]
    double homing_acceleration = 0.0;  ///< [m/s^2]
    std::uint32_t watchdog_ns = 0;     ///< silence after which the axis stops [ns]
};

struct Settings {
    std::uint32_t period_ns = 1'000'000;  ///< the tick [ns]
    std::uint8_t batch_ticks = 20;        ///< ticks in a telemetry batch, 1 to 100
    CommandMode mode = CommandMode::acceleration;
    double encoder_resolution = 1e-7;  ///< one count [m]
    std::uint8_t counter_bits = 32;    ///< width of the encoder's hardware counter, 16 or 32
    double step_length = 0.0;          ///< way of one step pulse [m]; 0: the drive takes no steps
    double max_following_error = 0.0;  ///< between reference and encoder [m]; 0: not looked at
    Limits widest;
    const char* name = "beam firmware";  ///< for people, at most 200 bytes
};

}  // namespace beam

#endif
