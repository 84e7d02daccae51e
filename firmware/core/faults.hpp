// Why an axis was stopped: the device's numbers of the table in docs/protocol.md, which explains them.

#ifndef BEAM_CORE_FAULTS_HPP
#define BEAM_CORE_FAULTS_HPP

#include <cstdint>

namespace beam {

enum class Fault : std::uint8_t {
    none = 0,
    host_silent = 1,
    setpoint_old = 2,
    underrun = 3,
    travel_limit = 4,
    speed_limit = 5,
    acceleration_limit = 6,
    effort_limit = 7,
    command_not_finite = 8,
    session_opened = 9,
    session_closed = 10,
    following_error = 11,
    end_switch = 12,
    drive_alarm = 13,
    encoder_lost = 14,
    homing_failed = 15,
    own_watchdog = 16,
};

}  // namespace beam

#endif
