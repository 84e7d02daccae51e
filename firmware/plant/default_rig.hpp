// The axis of the suite's default rig, for a board that nobody has told anything else. A test compares it with rig.yaml.

#ifndef BEAM_PLANT_DEFAULT_RIG_HPP
#define BEAM_PLANT_DEFAULT_RIG_HPP

#include "../core/settings.hpp"

namespace beam {

constexpr Settings default_rig() {
    Settings settings;
    settings.period_ns = 1'000'000;
    settings.batch_ticks = 20;
    settings.mode = CommandMode::acceleration;
    settings.encoder_resolution = 1e-7;
    settings.max_following_error = 0.002;
    settings.widest.travel = 0.1;
    settings.widest.max_speed = 0.5;
    settings.widest.max_acceleration = 10.0;
    settings.widest.max_effort = 20.0;
    settings.widest.stop_deceleration = 10.0;
    settings.widest.move_speed = 0.05;
    settings.widest.move_acceleration = 0.5;
    settings.widest.homing_speed = 0.02;
    settings.widest.homing_acceleration = 0.2;
    settings.widest.watchdog_ns = 250'000'000;
    return settings;
}

}  // namespace beam

#endif
