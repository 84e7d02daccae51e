// The axis at this board: its pins, or a plant that a program on the other side of a debugger plays.

#ifndef BEAM_STM32F405_AXIS_HPP
#define BEAM_STM32F405_AXIS_HPP

#include <cstdint>

#include "../core/board.hpp"
#include "../core/settings.hpp"

namespace beam::stm32 {

/// Takes the drive's current away: the first thing after a reset, and in every fault. It needs nothing but registers.
void cut_power();

/// Makes the axis ready; returns what it is. Where a plant stands behind the board, it is waited for.
Settings begin_axis(std::uint32_t boot_id);

/// What the interrupt of the second USART, which belongs to the axis, must call before the ticks are done.
void acknowledge();

/// Whether the reading of a tick has come; at pins it always has.
bool has_reading(std::uint64_t tick);

Reading measure();
void drive(const Drive& drive);

}  // namespace beam::stm32

#endif
