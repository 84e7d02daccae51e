// Any bytes against the core: whatever comes, the sanitizers find nothing and the hub stays within what it may.
//
// An input is cut into records: a byte for the time that passes, a byte for what follows, a byte for its length, and
// as many bytes. What follows are raw bytes of the line, or a payload that gets a good frame, so that more than the
// decoder is reached. With libFuzzer the inputs are its own; without, they are drawn here from a seed.

#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <memory>
#include <random>
#include <vector>

#include "../core/core.hpp"
#include "../plant/default_rig.hpp"
#include "virtual_board.hpp"

namespace {

constexpr double mass = 0.8;

/// Ends the program where the hub is moved as it may never be; the limits of the rig are the widest.
///
/// Under a force the core sees what a tick did to the speed when it is over: so much more of it there may be, and so
/// much further the stop ramp goes.
void require_safe(const beam::Settings& settings, const beam::IdealAxis& axis, const beam::Drive& drive) {
    const beam::Limits& most = settings.widest;
    const double period = settings.period_ns * 1e-9;
    const double ramp = most.stop_deceleration > most.max_acceleration ? most.stop_deceleration : most.max_acceleration;
    const bool is_forced = settings.mode == beam::CommandMode::effort;
    const double most_speed = most.max_speed * 1.001 + (is_forced ? 2.0 * most.max_effort / mass * period : 0.0);
    const double overshoot = (most_speed * most_speed - most.max_speed * most.max_speed) / (2.0 * ramp);
    const bool is_safe = std::isfinite(drive.position) && std::isfinite(drive.velocity) &&
                         std::isfinite(drive.acceleration) && std::isfinite(drive.effort) &&
                         std::fabs(drive.velocity) <= most_speed &&
                         std::fabs(drive.acceleration) <= ramp * 1.001 &&
                         std::fabs(drive.effort) <= most.max_effort * 1.001 &&
                         std::fabs(axis.position()) <= most.travel * 0.5 * 1.001 + most_speed * period + overshoot;
    if (!is_safe) {
        std::fprintf(stderr, "the hub is at %g m, reference %g m, %g m/s, %g m/s^2, %g N\n", axis.position(),
                     drive.position, drive.velocity, drive.acceleration, drive.effort);
        std::abort();
    }
}

class Scene {
public:
    explicit Scene(beam::CommandMode mode)
        : settings_(settings_of(mode)),
          axis_(settings_, 0.001, mass),
          board_(axis_),
          core_(std::make_unique<beam::Core>(board_, settings_)) {
        core_->start();
    }

    /// Opens a session with an enabled axis: from here most of the core can be reached.
    void enable() {
        say({0x01, 'B', 'E', 'A', 'M', 2, 2});
        std::uint8_t limits[96];
        beam::Writer message(limits);
        message.put(std::uint8_t{0x09});
        message.put(std::uint16_t{1});
        message.put(settings_.widest);
        say(std::vector<std::uint8_t>(limits, limits + message.size()));
        say({0x04, 1, 0, 2});
        for (int k = 0; k < 40; ++k) {
            pass(10);
            say({0x02});
        }
        say({0x04, 2, 0, 0});
    }

    void say(const std::vector<std::uint8_t>& payload) {
        std::uint8_t frame[beam::max_frame];
        if (!payload.empty()) {
            const std::size_t size = beam::encode_frame(payload.data(), payload.size(), frame);
            core_->receive(frame, size, board_.now_ns);
        }
    }

    void say_bytes(const std::uint8_t* data, std::size_t size) { core_->receive(data, size, board_.now_ns); }

    void pass(unsigned ticks) {
        for (unsigned k = 0; k < ticks; ++k) {
            board_.now_ns += settings_.period_ns;
            core_->tick();
            require_safe(settings_, axis_, board_.driven);
            core_->poll();
        }
        board_.output.clear();
    }

    std::uint64_t tick() const { return core_->next_tick(); }

private:
    static beam::Settings settings_of(beam::CommandMode mode) {
        beam::Settings settings = beam::default_rig();
        settings.mode = mode;
        settings.step_length = 1e-5;
        return settings;
    }

    beam::Settings settings_;
    beam::IdealAxis axis_;
    beam::VirtualBoard board_;
    std::unique_ptr<beam::Core> core_;
};

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
    if (size == 0) {
        return 0;
    }
    Scene scene(static_cast<beam::CommandMode>(data[0] & 3U));
    if ((data[0] & 4U) != 0) {
        scene.enable();
    }
    for (std::size_t at = 1; at + 3 <= size;) {
        scene.pass(data[at] & 31U);
        const bool is_framed = (data[at + 1] & 3U) != 0;
        std::size_t length = data[at + 2];
        at += 3;
        length = length < size - at ? length : size - at;
        if (is_framed) {
            scene.say(std::vector<std::uint8_t>(data + at, data + at + length));
        } else {
            scene.say_bytes(data + at, length);
        }
        at += length;
    }
    scene.pass(600);
    return 0;
}

#ifndef BEAM_LIBFUZZER

namespace {

using Random = std::mt19937_64;

std::uint64_t below(Random& random, std::uint64_t n) { return random() % n; }

/// Draws a number for a message: usual, extreme, or no number at all.
double draw_number(Random& random) {
    const double usual = (static_cast<double>(below(random, 2001)) - 1000.0) * 1e-3;
    switch (below(random, 12)) {
    case 0:
        return std::nan("");
    case 1:
        return HUGE_VAL;
    case 2:
        return usual * 1e300;
    case 3:
        return usual * 100.0;
    case 4:
        return 0.0;
    default:
        return usual * 10.0;
    }
}

/// Draws a message that a host could send.
std::vector<std::uint8_t> draw_message(Random& random, std::uint64_t tick, beam::CommandMode mode) {
    std::uint8_t buffer[1024];
    beam::Writer message(buffer);
    auto kind = static_cast<std::uint8_t>(1 + below(random, 10));
    if ((kind == 1 || kind == 8) && below(random, 16) != 0) {
        kind = 7;  // A session lasts long enough for something to happen in it.
    }
    const auto number = static_cast<std::uint16_t>(below(random, 8));
    message.put(kind);
    switch (kind) {
    case 1:
        message.put_bytes("BEAM", 4);
        message.put(static_cast<std::uint8_t>(below(random, 4)));
        message.put(static_cast<std::uint8_t>(below(random, 4)));
        break;
    case 3:
        message.put(number);
        break;
    case 4:
        message.put(static_cast<std::uint16_t>(random()));
        message.put(static_cast<std::uint8_t>(below(random, 3) == 0 ? below(random, 6) : 0));
        break;
    case 5:
        message.put(static_cast<std::uint16_t>(random()));
        message.put(draw_number(random));
        break;
    case 6:
        message.put(number);
        message.put(below(random, 8) == 0 ? random() : (tick + below(random, 100)) * 1'000'000U);
        message.put(static_cast<std::uint32_t>(below(random, 8) == 0 ? random() : below(random, 400)));
        break;
    case 7: {
        message.put(number);
        message.put(static_cast<std::uint32_t>(below(random, 8) == 0 ? random() : below(random, 100)));
        const std::uint64_t n = below(random, 101);
        const double value = draw_number(random);
        for (std::uint64_t k = 0; k < n; ++k) {
            message.put(value);
        }
        break;
    }
    case 9: {
        beam::Limits limits = beam::default_rig().widest;
        if (below(random, 2) == 0) {
            limits.travel = draw_number(random);
            limits.max_speed = draw_number(random);
            // Under a force a slow ramp makes much of little speed; `require_safe` reckons with the widest.
            if (mode != beam::CommandMode::effort) {
                limits.stop_deceleration = draw_number(random);
            }
            limits.watchdog_ns = static_cast<std::uint32_t>(random());
        }
        message.put(number);
        message.put(limits);
        break;
    }
    default:
        break;
    }
    std::vector<std::uint8_t> payload(buffer, buffer + message.size());
    if (below(random, 8) == 0) {
        payload[below(random, payload.size())] ^= static_cast<std::uint8_t>(1U << below(random, 8));
    }
    return payload;
}

}  // namespace

/// Usage: fuzz BYTES [SEED]. Draws sessions until so many bytes have gone into the core.
int main(int argc, char** argv) {
    const double bytes = argc > 1 ? std::atof(argv[1]) : 1e6;
    Random random(argc > 2 ? std::strtoull(argv[2], nullptr, 10) : 1);
    double done = 0.0;
    while (done < bytes) {
        const auto mode = static_cast<beam::CommandMode>(below(random, 4));
        Scene scene(mode);
        if (below(random, 8) != 0) {
            scene.enable();
        }
        for (int k = 0; k < 400; ++k) {
            if (below(random, 4) == 0) {
                scene.pass(static_cast<unsigned>(below(random, 100) == 0 ? 400 : below(random, 20)));
            }
            std::vector<std::uint8_t> piece;
            if (below(random, 8) == 0) {
                piece.resize(below(random, 3000));
                for (std::uint8_t& byte : piece) {
                    byte = static_cast<std::uint8_t>(random());
                }
                scene.say_bytes(piece.data(), piece.size());
            } else {
                piece = draw_message(random, scene.tick(), mode);
                scene.say(piece);
            }
            done += static_cast<double>(piece.size());
        }
        scene.pass(600);
    }
    std::printf("%.0f bytes\n", done);
    return 0;
}

#endif
