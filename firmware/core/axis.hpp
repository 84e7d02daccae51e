// A motion controller's axis: all that it does by itself, tick by tick.
//
// The axis runs on the table of transitions. Its own are the watchdogs, the alarms and the order of things within a
// tick: watch, decide, drive. Device time is the number of ticks; nothing is ever enabled again by itself.

#ifndef BEAM_CORE_AXIS_HPP
#define BEAM_CORE_AXIS_HPP

#include <cstdint>

#include "board.hpp"
#include "encoder.hpp"
#include "profiles.hpp"
#include "requests.hpp"
#include "sample_ring.hpp"
#include "settings.hpp"
#include "telemetry.hpp"
#include "transitions.hpp"

namespace beam {

enum class SequenceState : std::uint8_t { none, armed, running, done, aborted, underrun };

class Axis {
public:
    explicit Axis(const Settings& settings);

    /// Begins at a tick, with what the board measures then; says whether the hardware watchdog caused the start.
    void start(std::uint64_t tick, const Reading& reading, bool was_reset_by_watchdog);

    /// Does the next tick; returns what the drive has to do in it.
    const Drive& tick(const Reading& reading);

    // What the host asks for.

    /// Notes a sign of life of the host.
    void feed() {
        fed_tick_ = tick_;
        is_silent_ = false;
    }
    /// Obeys the smaller of these limits and the widest; only at rest and disabled, and not what no axis can have.
    void obey(const Limits& wanted);
    /// Begins a request; the answer is in it, or comes later.
    void ask(Request& request);
    /// Takes a set-point in the mode's unit; returns whether it is followed.
    bool take_setpoint(double value);
    /// Announces a sequence; returns whether it is accepted, and why.
    bool arm(std::uint16_t number, std::uint64_t start_ns, std::uint32_t n_samples, Text& answer);
    /// Decelerates to rest, then disables, because of something that the device noticed.
    void emergency_stop(Fault fault, const char* reason);
    /// Forgets what an earlier session left: requests, limits, sequence, unsent telemetry.
    void forget_session();

    // What the host sees.

    std::uint64_t next_tick() const { return tick_; }
    Condition condition() const { return condition_; }
    Appearance appearance() const { return appearances[static_cast<std::size_t>(condition_)]; }
    Fault fault() const { return fault_; }
    const Text& reason() const { return reason_; }
    std::int32_t position_count() const;
    std::int32_t velocity_count() const { return encoder_.step(); }
    std::uint16_t silences() const { return silences_; }
    std::uint64_t silence_tick() const { return silence_tick_; }
    /// The limits in force; all zero: none.
    Limits limits() const { return has_limits_ ? limits_ : Limits{}; }
    /// Counts the changes that the host has to see.
    std::uint32_t changes() const { return changes_; }
    SequenceState sequence_state() const { return sequence_state_; }
    std::uint16_t sequence_number() const { return sequence_number_; }
    const Text& sequence_reason() const { return sequence_reason_; }
    bool has_sequence() const { return condition_ == Condition::armed || condition_ == Condition::running; }

    SampleRing ring;
    Requests requests;
    Telemetry telemetry;

private:
    enum class Homing : std::uint8_t { seek, approach };

    const Transition* react(Cause cause, Fault fault = Fault::none, const Text& reason = Text(),
                            Request* request = nullptr);
    void do_effects(std::uint16_t effects, Fault fault, const Text& reason, Request* request);
    void end_sequence(SequenceState state, const Text& reason);
    Text answer_of(const char* words, Condition condition) const;
    const char* objection_to(Cause kind) const;

    void measure(const Reading& reading);
    void watch();
    void watch_axis();
    bool next_command(double& command);
    double own_velocity();
    double homing_velocity();

    void follow(double command);
    void lead(double velocity, double acceleration);
    void lead(double velocity);
    void count_steps();

    std::int64_t counts_from_zero() const { return encoder_.count() - zero_count_; }

    const Settings settings_;
    const double period_;
    const double tick_speed_;  ///< one count per tick [m/s]
    const std::int32_t greatest_step_;  ///< counts that the hub can really move in a tick
    Profiles profiles_;
    SpeedForecast forecast_;

    Limits limits_;
    bool has_limits_ = false;
    std::uint32_t watchdog_ticks_ = 0;

    Condition condition_ = Condition::identified;
    Fault fault_ = Fault::none;
    Text reason_;
    std::uint32_t changes_ = 0;

    std::uint64_t tick_ = 0;
    std::uint64_t first_tick_ = 0;
    Motion motion_;
    Drive drive_;
    double applied_ = 0.0;
    bool is_applied_measured_ = false;

    Encoder encoder_;
    std::int64_t zero_count_ = 0;
    std::int64_t last_count_from_zero_ = 0;
    std::int32_t last_step_ = 0;
    Reading reading_;
    bool is_encoder_lost_ = false;
    bool is_position_lost_ = false;

    std::uint64_t fed_tick_ = 0;
    bool is_silent_ = false;
    std::uint16_t silences_ = 0;
    std::uint64_t silence_tick_ = 0;

    double setpoint_ = 0.0;
    std::uint64_t setpoint_tick_ = 0;

    Homing homing_ = Homing::seek;
    bool began_below_home_ = false;
    double seek_start_ = 0.0;
    std::int64_t home_count_ = 0;

    std::int64_t steps_done_ = 0;

    std::uint16_t sequence_number_ = 0;
    SequenceState sequence_state_ = SequenceState::none;
    Text sequence_reason_;
};

}  // namespace beam

#endif
