// The axis's conditions and every transition between them: the table of docs/protocol.md, row by row.

#ifndef BEAM_CORE_TRANSITIONS_HPP
#define BEAM_CORE_TRANSITIONS_HPP

#include <array>
#include <cstddef>
#include <cstdint>
#include <initializer_list>

namespace beam {

enum class State : std::uint8_t { identified = 1, homed, enabled, fault };

enum class Activity : std::uint8_t { idle, homing, hold, setpoint, armed, sequence, stopping };

enum class Condition : std::uint8_t {
    identified,
    homing,
    homing_stops,
    homed,
    holding,
    following,
    armed,
    running,
    stopping,
    stopping_to_fault,
    fault,
    same,  ///< as a goal: nothing changes
};
constexpr std::size_t n_conditions = static_cast<std::size_t>(Condition::same);

/// The first five have the numbers of the line protocol's requests.
enum class Cause : std::uint8_t {
    enable,
    disable,
    home,
    stop,
    clear_fault,
    set_point,
    arm,
    emergency_stop,
    start,
    end,
    underrun,
    limit,
    silence,
    old_set_point,
    home_reached,
    rest,
    n_causes,
};
constexpr std::size_t n_causes = static_cast<std::size_t>(Cause::n_causes);

/// What is done on the way, in this order.
enum Effect : std::uint16_t {
    reason_cleared = 1U << 0U,
    watchdog_fed = 1U << 1U,
    homing_begun = 1U << 2U,
    zero_set = 1U << 3U,
    homing_answered = 1U << 4U,
    homing_failed = 1U << 5U,
    sequence_running = 1U << 6U,
    sequence_done = 1U << 7U,
    sequence_aborted = 1U << 8U,
    sequence_underrun = 1U << 9U,
    answered_at_rest = 1U << 10U,
    waiting_answered = 1U << 11U,
    reason_kept = 1U << 12U,
};

/// A condition as Status reports it, and in the words of an answer.
struct Appearance {
    State state;
    Activity activity;
    const char* words;
};

constexpr Appearance appearances[n_conditions] = {
    {State::identified, Activity::idle, "identified"},
    {State::identified, Activity::homing, "identified (homing)"},
    {State::identified, Activity::stopping, "identified (stopping)"},
    {State::homed, Activity::idle, "homed"},
    {State::enabled, Activity::hold, "enabled"},
    {State::enabled, Activity::setpoint, "enabled (setpoint)"},
    {State::enabled, Activity::armed, "enabled"},
    {State::enabled, Activity::sequence, "enabled (sequence)"},
    {State::enabled, Activity::stopping, "enabled (stopping)"},
    {State::enabled, Activity::stopping, "enabled (stopping)"},
    {State::fault, Activity::idle, "fault"},
};

constexpr const char* state_words(State state) {
    constexpr const char* words[] = {"", "identified", "homed", "enabled", "fault"};
    return words[static_cast<std::size_t>(state)];
}

struct Transition {
    std::uint16_t origins;
    std::uint16_t causes;
    Condition goal;
    std::uint16_t effects;
    const char* answer;  ///< what the host is answered at once; empty: nothing, or only later
    bool is_refused;
};

namespace table {

constexpr std::uint16_t in(std::initializer_list<Condition> conditions) {
    unsigned bits = 0;
    for (Condition condition : conditions) {
        bits |= 1U << static_cast<unsigned>(condition);
    }
    return static_cast<std::uint16_t>(bits);
}

constexpr std::uint16_t on(std::initializer_list<Cause> causes) {
    unsigned bits = 0;
    for (Cause cause : causes) {
        bits |= 1U << static_cast<unsigned>(cause);
    }
    return static_cast<std::uint16_t>(bits);
}

constexpr Transition row(std::uint16_t origins, std::uint16_t causes, Condition goal, unsigned effects,
                         const char* answer = "") {
    return {origins, causes, goal, static_cast<std::uint16_t>(effects), answer, false};
}

constexpr Transition refused(std::uint16_t origins, std::uint16_t causes, const char* answer) {
    return {origins, causes, Condition::same, 0, answer, true};
}

using C = Condition;
using K = Cause;

constexpr Transition rows[] = {
    // clang-format off
    row(in({C::homed}), on({K::enable}), C::holding, reason_cleared | watchdog_fed, "enabled"),
    row(in({C::holding, C::following, C::armed, C::running}), on({K::enable}), C::same, 0, "already enabled"),
    refused(in({C::identified, C::homing, C::homing_stops}), on({K::enable}), "cannot enable: the axis is {condition}; home it first"),
    refused(in({C::stopping, C::stopping_to_fault}), on({K::enable}), "cannot enable: the axis is {condition}; wait until it rests"),
    refused(in({C::fault}), on({K::enable}), "cannot enable: the axis is {condition}; clear the fault first ({reason})"),
    row(in({C::identified, C::homed}), on({K::home}), C::homing, reason_cleared | watchdog_fed | homing_begun),
    refused(in({C::homing, C::homing_stops}), on({K::home}), "cannot home: the axis is {condition}; wait until it rests"),
    refused(in({C::holding, C::following, C::armed, C::running, C::stopping, C::stopping_to_fault}), on({K::home}), "cannot home: the axis is {condition}; disable it first"),
    refused(in({C::fault}), on({K::home}), "cannot home: the axis is {condition}; clear the fault first"),
    row(in({C::homing}), on({K::home_reached}), C::homed, zero_set | homing_answered),
    row(in({C::identified, C::homed, C::fault}), on({K::stop, K::disable}), C::same, 0, "already {state} and at rest"),
    row(in({C::homing}), on({K::stop, K::disable}), C::homing_stops, homing_failed | answered_at_rest),
    row(in({C::holding, C::following}), on({K::stop, K::disable}), C::stopping, answered_at_rest),
    row(in({C::armed, C::running}), on({K::stop, K::disable}), C::stopping, sequence_aborted | answered_at_rest),
    row(in({C::homing_stops, C::stopping, C::stopping_to_fault}), on({K::stop, K::disable}), C::same, answered_at_rest),
    row(in({C::homing_stops}), on({K::rest}), C::identified, waiting_answered),
    row(in({C::stopping}), on({K::rest}), C::homed, waiting_answered),
    row(in({C::stopping_to_fault}), on({K::rest}), C::fault, waiting_answered),
    row(in({C::fault}), on({K::clear_fault}), C::homed, reason_cleared, "fault cleared"),
    row(in({C::identified, C::homing, C::homing_stops, C::homed, C::holding, C::following, C::armed, C::running, C::stopping, C::stopping_to_fault}), on({K::clear_fault}), C::same, 0, "there is no fault"),
    row(in({C::holding, C::following}), on({K::set_point}), C::following, 0, "set-point taken"),
    refused(in({C::armed, C::running}), on({K::set_point}), "set-point: a sequence is loaded"),
    refused(in({C::identified, C::homing, C::homing_stops, C::homed, C::fault, C::stopping, C::stopping_to_fault}), on({K::set_point}), "set-point: the axis is {condition}, expected enabled"),
    row(in({C::following}), on({K::old_set_point}), C::stopping, reason_kept),
    row(in({C::following}), on({K::limit}), C::stopping_to_fault, reason_kept),
    row(in({C::holding, C::following}), on({K::arm}), C::armed, 0, "sequence armed"),
    refused(in({C::armed, C::running}), on({K::arm}), "sequence: another one is loaded"),
    refused(in({C::identified, C::homing, C::homing_stops, C::homed, C::fault, C::stopping, C::stopping_to_fault}), on({K::arm}), "sequence: the axis is {condition}, expected enabled"),
    row(in({C::armed}), on({K::start}), C::running, sequence_running),
    row(in({C::running}), on({K::end}), C::holding, sequence_done),
    row(in({C::running}), on({K::underrun}), C::stopping, sequence_underrun | reason_kept),
    row(in({C::running}), on({K::limit}), C::stopping_to_fault, sequence_aborted | reason_kept),
    row(in({C::identified, C::homed, C::fault}), on({K::emergency_stop, K::silence}), C::same, 0),
    row(in({C::homing_stops, C::stopping, C::stopping_to_fault}), on({K::silence}), C::same, 0),
    row(in({C::homing}), on({K::emergency_stop, K::silence}), C::homing_stops, homing_failed | reason_kept),
    row(in({C::holding, C::following}), on({K::emergency_stop, K::silence}), C::stopping, reason_kept),
    row(in({C::armed, C::running}), on({K::emergency_stop, K::silence}), C::stopping, sequence_aborted | reason_kept),
    row(in({C::homing_stops, C::stopping, C::stopping_to_fault}), on({K::emergency_stop}), C::same, reason_kept),
    // clang-format on
};

constexpr std::uint8_t no_row = 0xFF;
using Index = std::array<std::array<std::uint8_t, n_causes>, n_conditions>;

std::uint8_t two_rows_for_one_pair();  // never defined: calling it is no constant, so it does not compile

/// The row of each pair of condition and cause; two rows for one pair do not compile.
constexpr Index make_index() {
    Index index{};
    for (std::size_t condition = 0; condition < n_conditions; ++condition) {
        for (std::size_t cause = 0; cause < n_causes; ++cause) {
            index[condition][cause] = no_row;
            for (std::size_t i = 0; i < sizeof rows / sizeof rows[0]; ++i) {
                if (((rows[i].origins >> condition) & 1U) != 0 && ((rows[i].causes >> cause) & 1U) != 0) {
                    index[condition][cause] =
                        index[condition][cause] == no_row ? static_cast<std::uint8_t>(i) : two_rows_for_one_pair();
                }
            }
        }
    }
    return index;
}

inline constexpr Index index = make_index();

}  // namespace table

/// Returns the row for a cause in a condition; null where the cause cannot come about there.
constexpr const Transition* transition(Condition condition, Cause cause) {
    const std::uint8_t i = table::index[static_cast<std::size_t>(condition)][static_cast<std::size_t>(cause)];
    return i == table::no_row ? nullptr : &table::rows[i];
}

}  // namespace beam

#endif
