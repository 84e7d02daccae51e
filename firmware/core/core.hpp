// The firmware: bytes of the host's line in and out, ticks in between. docs/protocol.md is its specification.

#ifndef BEAM_CORE_CORE_HPP
#define BEAM_CORE_CORE_HPP

#include <cstddef>
#include <cstdint>

#include "axis.hpp"
#include "board.hpp"
#include "framing.hpp"
#include "settings.hpp"
#include "wire.hpp"

namespace beam {

class Core {
public:
    Core(Board& board, const Settings& settings);

    /// Begins: the first tick is the next one by the board's clock.
    void start();

    /// Does the next tick if it is due; returns whether it did.
    bool tick();

    /// Takes bytes of the host's line, which came at `arrived_ns` of the board's clock.
    void receive(const std::uint8_t* data, std::size_t size, std::uint64_t arrived_ns);

    /// Sends what waits, and feeds the hardware watchdog while ticks go on.
    void poll();

    std::uint64_t next_tick() const { return axis_.next_tick(); }
    const Axis& axis() const { return axis_; }

private:
    class Hold;

    void handle(const std::uint8_t* payload, std::size_t size, std::uint64_t arrived_ns);
    void open_session(std::uint8_t lowest, std::uint8_t highest);
    void answer_request(std::uint16_t number, std::uint8_t kind);
    void answer_arm(std::uint16_t number, std::uint64_t start_ns, std::uint32_t n_samples);
    void take_setpoint(std::uint16_t number, double value);
    void take_samples(std::uint16_t number, std::uint32_t first, Reader& reader);

    void send_identity(std::uint8_t version);
    void send_status();
    void send_reply(const Request& request);
    void send_arm_reply();
    bool send_batch();
    void send(const Writer& message);
    void write();

    Board& board_;
    const Settings settings_;
    Axis axis_;
    FrameDecoder decoder_;

    bool is_in_session_ = false;
    std::uint64_t heard_ns_ = 0;
    std::uint64_t identified_ns_ = 0;
    bool has_identified_ = false;
    std::uint32_t changes_sent_ = 0;
    std::uint64_t tick_fed_ = 0;

    std::uint16_t setpoint_number_ = 0;
    std::uint16_t setpoints_refused_ = 0;
    bool has_arm_reply_ = false;
    std::uint16_t arm_number_ = 0;
    bool is_arm_accepted_ = false;
    Text arm_answer_;

    std::uint8_t payload_[max_payload] = {};
    std::uint8_t frame_[max_frame] = {};
    static constexpr std::size_t output_size = 8192;
    std::uint8_t output_[output_size] = {};
    std::size_t output_begin_ = 0;
    std::size_t output_used_ = 0;
};

}  // namespace beam

#endif
