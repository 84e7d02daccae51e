#include "axis.hpp"

#include <cmath>

namespace beam {

namespace {

constexpr std::int32_t largest_count = 0x7FFFFFFF;

std::int32_t as_count(std::int64_t value) {
    return value > largest_count ? largest_count : value < -largest_count ? -largest_count : static_cast<std::int32_t>(value);
}

std::int64_t rounded(double value) { return static_cast<std::int64_t>(value < 0.0 ? value - 0.5 : value + 0.5); }

bool is_positive(double value) { return std::isfinite(value) && value > 0.0; }

double lesser(double a, double b) { return a < b ? a : b; }

/// Whether an axis can have these limits.
bool is_possible(const Limits& limits) {
    for (double value : {limits.travel, limits.max_speed, limits.max_acceleration, limits.max_effort,
                         limits.stop_deceleration, limits.move_speed, limits.move_acceleration,
                         limits.homing_speed, limits.homing_acceleration}) {
        if (!is_positive(value)) {
            return false;
        }
    }
    return limits.watchdog_ns > 0;
}

Limits narrower(const Limits& a, const Limits& b) {
    Limits least;
    least.travel = lesser(a.travel, b.travel);
    least.max_speed = lesser(a.max_speed, b.max_speed);
    least.max_acceleration = lesser(a.max_acceleration, b.max_acceleration);
    least.max_effort = lesser(a.max_effort, b.max_effort);
    least.stop_deceleration = lesser(a.stop_deceleration, b.stop_deceleration);
    least.move_speed = lesser(a.move_speed, b.move_speed);
    least.move_acceleration = lesser(a.move_acceleration, b.move_acceleration);
    least.homing_speed = lesser(a.homing_speed, b.homing_speed);
    least.homing_acceleration = lesser(a.homing_acceleration, b.homing_acceleration);
    least.watchdog_ns = a.watchdog_ns < b.watchdog_ns ? a.watchdog_ns : b.watchdog_ns;
    return least;
}

void set_wait(Request* request, Request::Wait wait) {
    if (request != nullptr) {
        request->wait = wait;
    }
}

std::uint32_t whole_periods(std::uint32_t time_ns, std::uint32_t period_ns) {
    return static_cast<std::uint32_t>((static_cast<std::uint64_t>(time_ns) + period_ns / 2) / period_ns);
}

}  // namespace

Axis::Axis(const Settings& settings)
    : ring(settings.mode == CommandMode::position),
      settings_(settings),
      period_(settings.period_ns * 1e-9),
      tick_speed_(settings.encoder_resolution / period_),
      greatest_step_(as_count(rounded(lesser(2.0 * settings.widest.max_speed / tick_speed_ + 100.0, 1e9)))),
      profiles_(settings.mode, period_),
      forecast_(tick_speed_),
      limits_(settings.widest),
      watchdog_ticks_(whole_periods(settings.widest.watchdog_ns, settings.period_ns)),
      encoder_(settings.counter_bits) {}

void Axis::start(std::uint64_t tick, const Reading& reading, bool was_reset_by_watchdog) {
    if (was_reset_by_watchdog) {
        fault_ = Fault::own_watchdog;
        reason_ = "the controller's processor had stopped and was reset";
    }
    tick_ = first_tick_ = fed_tick_ = setpoint_tick_ = tick;
    reading_ = reading;
    encoder_.start(reading.counter);
}

// Ticks --------------------------------------------------------------------------------------------------------

const Drive& Axis::tick(const Reading& reading) {
    measure(reading);
    watch();
    double command = 0.0;
    bool is_led = true;
    if (next_command(command)) {
        Breach breach;
        const double change = settings_.mode == CommandMode::effort
                                  ? forecast_.change(command, motion_.velocity, limits_)
                                  : 0.0;
        if (profiles_.is_beyond(command, change, motion_, limits_, breach)) {
            react(Cause::limit, breach.fault, breach.reason);
        } else {
            follow(command);
            is_led = false;
        }
    }
    if (is_led) {
        forecast_.forget();
        lead(own_velocity());
    }
    drive_.tick = tick_;
    drive_.is_powered = appearance().activity != Activity::idle;
    count_steps();
    ++tick_;
    return drive_;
}

/// Takes what the board measured, and completes the sample of the tick that has just ended.
void Axis::measure(const Reading& reading) {
    reading_ = reading;
    encoder_.update(reading.counter);
    if (tick_ != first_tick_) {
        Sample sample;
        // The speed at a tick is what the hub moves from the tick before it to the one after it, by two.
        const std::int64_t both = static_cast<std::int64_t>(last_step_) + encoder_.step();
        sample.applied = is_applied_measured_ ? static_cast<double>(reading.effort) : applied_;
        sample.position = as_count(last_count_from_zero_);
        sample.velocity = as_count((both < 0 ? both - 1 : both + 1) / 2);
        sample.effort = reading.effort;
        telemetry.add(tick_ - 1, sample);
    }
    const std::int32_t step = encoder_.step();
    is_encoder_lost_ = !reading.is_counter_valid || step > greatest_step_ || step < -greatest_step_;
    // What an encoder that is lost says of a free hub is no motion: the ramp begins with the speed before.
    if (drive_.is_free && !is_encoder_lost_) {
        // The last tick's mean speed is half a tick old; it goes on changing as it did from the tick before.
        motion_.position = static_cast<double>(counts_from_zero()) * settings_.encoder_resolution;
        motion_.velocity = (1.5 * step - 0.5 * last_step_) * tick_speed_;
    }
    last_step_ = step;
    last_count_from_zero_ = counts_from_zero();
}

/// Stops on silence, of the host or of its set-points, and on alarms of the axis.
void Axis::watch() {
    if (!is_silent_ && tick_ - fed_tick_ > watchdog_ticks_) {
        is_silent_ = true;
        ++silences_;
        ++changes_;
        silence_tick_ = tick_;
        react(Cause::silence, Fault::host_silent,
              Text("watchdog: no word from the host for ") << limits_.watchdog_ns * 1e-9 << " s");
    }
    if (condition_ == Condition::following && settings_.mode != CommandMode::position &&
        tick_ - setpoint_tick_ > watchdog_ticks_) {
        react(Cause::old_set_point, Fault::setpoint_old,
              Text("set-point not refreshed for ") << limits_.watchdog_ns * 1e-9 << " s");
    }
    watch_axis();
    if (condition_ == Condition::armed && tick_ >= ring.start_tick()) {
        react(Cause::start);
    }
}

/// Stops where encoder, drive or end switches report trouble; after that the position is not trusted before homing.
void Axis::watch_axis() {
    is_position_lost_ = is_position_lost_ || is_encoder_lost_ || reading_.has_lost_steps;
    const Activity activity = appearance().activity;
    if (activity == Activity::idle || activity == Activity::stopping) {
        return;
    }
    if (is_encoder_lost_) {
        emergency_stop(Fault::encoder_lost, "the encoder gives no valid position");
    } else if (reading_.has_lost_steps) {
        emergency_stop(Fault::following_error, "a tick was late, or had more steps than get out in its time");
    } else if (reading_.has_drive_alarm) {
        is_position_lost_ = true;
        emergency_stop(Fault::drive_alarm, "the motor's drive reports an alarm");
    } else if ((reading_.is_at_low_end && motion_.velocity < 0.0) ||
               (reading_.is_at_high_end && motion_.velocity > 0.0)) {
        is_position_lost_ = true;
        emergency_stop(Fault::end_switch, "the hub moved onto an end switch");
    } else if (settings_.max_following_error > 0.0 && !drive_.is_free &&
               magnitude(motion_.position -
                         static_cast<double>(counts_from_zero()) * settings_.encoder_resolution) >
                   settings_.max_following_error) {
        is_position_lost_ = true;
        emergency_stop(Fault::following_error, "the hub does not follow its reference");
    }
}

/// Puts this tick's command in `command`; returns whether there is one.
bool Axis::next_command(double& command) {
    if (condition_ == Condition::following) {
        command = profiles_.command_towards(setpoint_, motion_, limits_);
        return true;
    }
    if (condition_ != Condition::running) {
        return false;
    }
    if (ring.is_used_up()) {
        react(Cause::end);
        return false;
    }
    if (ring.take(command)) {
        return true;
    }
    react(Cause::underrun, Fault::underrun,
          Text("underrun: sample ") << static_cast<std::uint64_t>(ring.awaited()) << " of "
                                    << static_cast<std::uint64_t>(ring.n_samples()) << " did not come in time");
    return false;
}

/// Returns the velocity for the end of this tick where the axis itself decides: hold, brake, home.
double Axis::own_velocity() {
    if (condition_ == Condition::homing) {
        const double velocity = homing_velocity();
        if (condition_ == Condition::homing || condition_ == Condition::homed) {
            return velocity;
        }
    }
    if (appearance().activity == Activity::stopping && motion_.velocity == 0.0) {
        react(Cause::rest);
    }
    return profiles_.braked(motion_.velocity, limits_);
}

/// Looks for the edge of the home switch, then moves back to where it was passed.
double Axis::homing_velocity() {
    const double step = limits_.homing_acceleration * period_;
    if (homing_ == Homing::seek) {
        if (reading_.is_below_home == began_below_home_) {
            if (magnitude(motion_.position - seek_start_) > limits_.travel) {
                is_position_lost_ = true;
                emergency_stop(Fault::homing_failed, "the home switch does not change over the whole travel");
                return 0.0;
            }
            const double wanted = began_below_home_ ? limits_.homing_speed : -limits_.homing_speed;
            return clamped(wanted, motion_.velocity - step, motion_.velocity + step);
        }
        home_count_ = reading_.has_home_counter ? encoder_.count_of(reading_.home_counter) : encoder_.count();
        homing_ = Homing::approach;
    }
    const double home = static_cast<double>(home_count_ - zero_count_) * settings_.encoder_resolution;
    const double distance = home - motion_.position;
    if (magnitude(distance) < arrived && magnitude(motion_.velocity) < arrived / period_) {
        react(Cause::home_reached);
        return 0.0;
    }
    return profiles_.towards(distance, motion_.velocity, limits_.homing_speed, limits_.homing_acceleration);
}

/// Follows a command of the mode for a tick; the arithmetic is that of the suite's simulator.
void Axis::follow(double command) {
    switch (settings_.mode) {
    case CommandMode::acceleration:
        lead(motion_.velocity + command * period_, command);
        break;
    case CommandMode::velocity:
        lead(command, 0.0);
        break;
    case CommandMode::position:
        applied_ = motion_.position;
        lead((command - motion_.position) / period_, 0.0);
        motion_.position = command;
        break;
    case CommandMode::effort:
        drive_.is_free = true;
        drive_.position = motion_.position;
        drive_.velocity = motion_.velocity;
        drive_.acceleration = 0.0;
        drive_.effort = applied_ = command;
        is_applied_measured_ = false;
        break;
    }
}

/// Leads the hub to a velocity at the end of the tick.
void Axis::lead(double velocity) {
    lead(velocity, profiles_.is_ramped() ? (velocity - motion_.velocity) / period_ : 0.0);
}

void Axis::lead(double velocity, double acceleration) {
    drive_.is_free = false;
    drive_.position = motion_.position;
    drive_.velocity = profiles_.is_ramped() ? motion_.velocity : velocity;
    drive_.acceleration = acceleration;
    drive_.effort = 0.0;
    is_applied_measured_ = settings_.mode == CommandMode::effort;
    applied_ = settings_.mode == CommandMode::acceleration ? acceleration
               : settings_.mode == CommandMode::velocity   ? velocity
                                                           : motion_.position;
    const double mean = profiles_.is_ramped() ? motion_.velocity + acceleration * (period_ * 0.5) : velocity;
    motion_.position += mean * period_;
    motion_.velocity = velocity;
}

/// Steps are counted from the absolute reference, so that no rounding of a tick is ever lost.
void Axis::count_steps() {
    drive_.steps = 0;
    if (settings_.step_length > 0.0) {
        const std::int64_t steps = rounded(motion_.position / settings_.step_length);
        drive_.steps = as_count(steps - steps_done_);
        steps_done_ = steps;
    }
}

// What the host asks for ---------------------------------------------------------------------------------------

void Axis::obey(const Limits& wanted) {
    if (appearance().activity != Activity::idle || !is_possible(wanted)) {
        return;
    }
    limits_ = narrower(wanted, settings_.widest);
    has_limits_ = true;
    forecast_.forget_mobility();
    watchdog_ticks_ = whole_periods(limits_.watchdog_ns, settings_.period_ns);
}

/// Returns why the device does not do what the table allows, or null.
const char* Axis::objection_to(Cause kind) const {
    if (kind != Cause::enable && kind != Cause::home) {
        return nullptr;
    }
    if (!has_limits_) {
        return "the axis has no limits; set them first";
    }
    if (reading_.has_drive_alarm) {
        return "the motor's drive reports an alarm";
    }
    if (!reading_.is_counter_valid) {
        return "the encoder gives no valid position";
    }
    if (kind == Cause::enable && is_position_lost_) {
        return "the axis has lost its position; home it first";
    }
    return nullptr;
}

void Axis::ask(Request& request) {
    const Transition* row = transition(condition_, request.kind);
    const char* objection = row->goal != Condition::same || !has_limits_ ? objection_to(request.kind) : nullptr;
    if (objection != nullptr) {
        request.answer(Phase::failure, Text(request.kind == Cause::home ? "cannot home: " : "cannot enable: ")
                                           << objection);
        return;
    }
    // The answer speaks of the condition before.
    const Text answer = answer_of(row->answer, condition_);
    const char* reason = request.kind == Cause::stop      ? "stop was asked for"
                         : request.kind == Cause::disable ? "disable was asked for"
                                                          : "";
    react(request.kind, Fault::none, reason, &request);
    if (answer.size() != 0) {
        request.answer(row->is_refused ? Phase::failure : Phase::success, answer);
    }
}

bool Axis::take_setpoint(double value) {
    if (!(magnitude(value) <= command_limit(settings_.mode, limits_))) {
        return false;
    }
    const Transition* row = react(Cause::set_point);
    if (row->is_refused) {
        return false;
    }
    setpoint_ = value;
    setpoint_tick_ = tick_;
    return true;
}

bool Axis::arm(std::uint16_t number, std::uint64_t start_ns, std::uint32_t n_samples, Text& answer) {
    const std::uint64_t start_tick =
        start_ns / settings_.period_ns + (start_ns % settings_.period_ns != 0 ? 1 : 0);
    const Transition* row = transition(condition_, Cause::arm);
    answer = Text();
    if (!row->is_refused) {
        if (motion_.velocity != 0.0) {
            answer << "sequence: the hub moves with " << motion_.velocity << " m/s, expected it at rest";
        } else if (start_tick < tick_) {
            answer << "sequence: its start was " << static_cast<double>(tick_ - start_tick) * period_ << " s ago";
        } else if (n_samples < 2) {
            answer << "sequence: " << static_cast<std::uint64_t>(n_samples) << " samples, expected at least 2";
        }
        if (answer.size() != 0) {
            return false;
        }
    }
    answer = answer_of(row->answer, condition_);
    react(Cause::arm);
    if (row->is_refused) {
        return false;
    }
    ring.announce(start_tick, n_samples);
    sequence_number_ = number;
    sequence_state_ = SequenceState::armed;
    sequence_reason_ = Text();
    return true;
}

void Axis::emergency_stop(Fault fault, const char* reason) { react(Cause::emergency_stop, fault, reason); }

void Axis::forget_session() {
    requests.forget();
    telemetry.clear();
    has_limits_ = false;
    silences_ = 0;
    silence_tick_ = 0;
    ring.announce(0, 0);
    sequence_number_ = 0;
    sequence_state_ = SequenceState::none;
    sequence_reason_ = Text();
}

std::int32_t Axis::position_count() const { return as_count(counts_from_zero()); }

// The table of transitions -------------------------------------------------------------------------------------

/// Does what the table says of a cause in the present condition; returns the row.
const Transition* Axis::react(Cause cause, Fault fault, const Text& reason, Request* request) {
    const Transition* row = transition(condition_, cause);
    do_effects(row->effects, fault, reason, request);
    if (row->goal != Condition::same && row->goal != condition_) {
        condition_ = row->goal;
        ++changes_;
        if (!has_sequence()) {
            ring.clear();
        }
    }
    return row;
}

void Axis::do_effects(std::uint16_t effects, Fault fault, const Text& reason, Request* request) {
    if ((effects & reason_cleared) != 0) {
        fault_ = Fault::none;
        reason_ = Text();
    }
    if ((effects & watchdog_fed) != 0) {
        feed();
        // A hub that was moved by hand while it was off begins where it is.
        const double measured = static_cast<double>(counts_from_zero()) * settings_.encoder_resolution;
        if (magnitude(measured - motion_.position) > settings_.encoder_resolution) {
            motion_.position = measured;
        }
    }
    if ((effects & homing_begun) != 0) {
        homing_ = Homing::seek;
        began_below_home_ = reading_.is_below_home;
        seek_start_ = motion_.position;
        set_wait(request, Request::Wait::home);
    }
    if ((effects & zero_set) != 0) {
        zero_count_ = home_count_;
        motion_.position = 0.0;
        steps_done_ = 0;
        is_position_lost_ = false;
    }
    if ((effects & (homing_answered | homing_failed)) != 0) {
        for (Request& waiting : requests) {
            if (waiting.wait != Request::Wait::home) {
                continue;
            }
            if ((effects & homing_answered) != 0) {
                waiting.answer(Phase::success, "homed");
            } else {
                waiting.answer(Phase::failure, Text("homing ended early: ") << reason);
            }
        }
    }
    if ((effects & sequence_running) != 0) {
        end_sequence(SequenceState::running, reason);
    }
    if ((effects & sequence_done) != 0) {
        end_sequence(SequenceState::done, reason);
    }
    if ((effects & sequence_aborted) != 0) {
        end_sequence(SequenceState::aborted, reason);
    }
    if ((effects & sequence_underrun) != 0) {
        end_sequence(SequenceState::underrun, reason);
    }
    if ((effects & answered_at_rest) != 0) {
        set_wait(request, Request::Wait::rest);
    }
    if ((effects & waiting_answered) != 0) {
        for (Request& waiting : requests) {
            if (waiting.wait == Request::Wait::rest) {
                waiting.answer(Phase::success, waiting.kind == Cause::stop ? "stopped" : "disabled");
            }
        }
    }
    if ((effects & reason_kept) != 0) {
        fault_ = fault;
        reason_ = reason;
        ++changes_;
    }
}

void Axis::end_sequence(SequenceState state, const Text& reason) {
    sequence_state_ = state;
    sequence_reason_ = reason;
    ++changes_;
}

/// Returns an answer of the table, with the condition, its state and the reason filled in.
Text Axis::answer_of(const char* words, Condition condition) const {
    const Appearance now = appearances[static_cast<std::size_t>(condition)];
    Text answer;
    char letter[2] = {0, 0};
    for (; *words != '\0'; ++words) {
        if (*words != '{') {
            letter[0] = *words;
            answer << letter;
            continue;
        }
        switch (words[1]) {
        case 'c':
            answer << now.words;
            break;
        case 's':
            answer << state_words(now.state);
            break;
        default:
            answer << reason_;
            break;
        }
        while (*words != '}') {
            ++words;
        }
    }
    return answer;
}

}  // namespace beam
