// What the core needs of a board, and what a board calls. A port to another board is one class derived from Board.
//
// The board's program makes a Board and a Core, calls core.start() once, and then for ever:
//
//     core.tick()      in the timer's interrupt at every beginning of a period, or in the loop: does the next tick if
//                      the board's clock says that it is due, and returns whether it did (call it until it does not)
//     core.receive()   in the loop, with the bytes that came over the host's line
//     core.poll()      in the loop: writes what waits for the host's line, feeds the hardware watchdog
//
// Nothing in the core blocks, waits or allocates. Where ticks come from an interrupt, hold_ticks() and release_ticks()
// keep it out while the loop changes what both use; where they come from the same loop, the two do nothing.

#ifndef BEAM_CORE_BOARD_HPP
#define BEAM_CORE_BOARD_HPP

#include <cstddef>
#include <cstdint>

namespace beam {

/// What the board measures at the beginning of a tick.
struct Reading {
    std::uint32_t counter = 0;       ///< the encoder's free-running counter; it grows along +x and wraps
    std::uint32_t home_counter = 0;  ///< the counter where the home switch last changed (latched by hardware)
    float effort = 0.0F;             ///< mean force on the hub in the tick that has just ended [N]; 0: not measured
    bool is_counter_valid = true;    ///< whether the encoder works
    bool has_home_counter = false;   ///< whether the home switch has changed since the reset
    bool is_below_home = false;      ///< the home switch: it is on everywhere on the negative side of home
    bool is_at_low_end = false;      ///< the end switch at -x
    bool is_at_high_end = false;     ///< the end switch at +x
    bool has_drive_alarm = false;
    bool has_lost_steps = false;     ///< the steps of an earlier tick did not all get out in its time
};

/// What the drive has to do during a tick.
struct Drive {
    std::uint64_t tick = 0;
    bool is_powered = false;    ///< whether the axis is enabled, homing or stopping; else the drive may be off
    bool is_free = false;       ///< whether the hub is free under `effort`; else it follows the reference
    double position = 0.0;      ///< reference at the tick's beginning [m]; its zero changes when home is found
    double velocity = 0.0;      ///< at the tick's beginning, after any jump [m/s]
    double acceleration = 0.0;  ///< held over the tick [m/s^2]
    double effort = 0.0;        ///< held over the tick where the hub is free [N]
    std::int32_t steps = 0;     ///< step pulses to spread evenly over the tick, signed
};

class Board {
public:
    /// Nanoseconds since boot (any start will do); never goes back. Tick k begins at k periods.
    virtual std::uint64_t clock_ns() = 0;
    /// Another number after every start.
    virtual std::uint32_t boot_id() = 0;
    /// Whether the hardware watchdog caused this start.
    virtual bool was_reset_by_watchdog() = 0;

    /// Takes as many bytes for the host's line as fit without waiting; returns how many.
    virtual std::size_t write(const std::uint8_t* data, std::size_t size) = 0;

    /// Called at the beginning of every tick, before drive().
    virtual Reading measure() = 0;
    virtual void drive(const Drive& drive) = 0;

    /// Called by poll() while ticks go on.
    virtual void feed_watchdog() = 0;

    /// Keeps the tick's interrupt out; never nested.
    virtual void hold_ticks() = 0;
    virtual void release_ticks() = 0;

    Board(const Board&) = delete;
    Board& operator=(const Board&) = delete;

protected:
    Board() = default;
    ~Board() = default;
};

}  // namespace beam

#endif
