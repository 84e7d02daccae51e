// A board's end of the plant port: a program that plays the motor, on a second stream of bytes (docs/firmware.md).

#ifndef BEAM_PLANT_PLANT_PORT_HPP
#define BEAM_PLANT_PLANT_PORT_HPP

#include <cstddef>
#include <cstdint>
#include <cstring>
#include <initializer_list>

#include "../core/board.hpp"
#include "../core/framing.hpp"
#include "../core/settings.hpp"
#include "../core/wire.hpp"

namespace beam {

/// The signals of a reading, as the plant port has them.
inline std::uint8_t flags_of(const Reading& reading) {
    std::uint8_t flags = 0;
    std::uint8_t bit = 1;
    for (bool is_on : {reading.is_counter_valid, reading.has_home_counter, reading.is_below_home,
                       reading.is_at_low_end, reading.is_at_high_end, reading.has_drive_alarm,
                       reading.has_lost_steps}) {
        flags = static_cast<std::uint8_t>(flags | (is_on ? bit : 0U));
        bit = static_cast<std::uint8_t>(bit << 1U);
    }
    return flags;
}

inline void set_flags(Reading& reading, std::uint8_t flags) {
    for (bool* signal : {&reading.is_counter_valid, &reading.has_home_counter, &reading.is_below_home,
                         &reading.is_at_low_end, &reading.is_at_high_end, &reading.has_drive_alarm,
                         &reading.has_lost_steps}) {
        *signal = (flags & 1U) != 0;
        flags = static_cast<std::uint8_t>(flags >> 1U);
    }
}

class PlantPort {
public:
    /// `settings`: what a Setup does not name.
    PlantPort(const Settings& settings, std::uint32_t boot_id) : settings_(settings), boot_id_(boot_id) {}

    /// Takes bytes of the plant.
    void receive(const std::uint8_t* data, std::size_t size) {
        for (std::size_t i = 0; i < size; ++i) {
            const std::size_t payload_size = decoder_.feed(data[i]);
            if (payload_size != 0) {
                handle(decoder_.payload(), payload_size);
            }
        }
    }

    /// Says again what has not been answered.
    void poll(std::uint64_t now_ns) {
        if (has_reading_ || (said_ns_ != 0 && now_ns - said_ns_ < repeat_ns)) {
            return;
        }
        said_ns_ = now_ns;
        if (is_set_up_ && has_driven_) {
            say_drive();
        } else {
            std::uint8_t payload[8];
            Writer message(payload);
            message.put(boot_type);
            message.put(boot_id_);
            say(payload, message.size());
        }
    }

    /// Whether the plant has said what axis it is, and where it stands.
    bool is_set_up() const { return is_set_up_ && has_reading_; }
    const Settings& settings() const { return settings_; }

    /// Whether the reading of a tick has come.
    bool has_reading(std::uint64_t tick) const { return has_reading_ && (!has_driven_ || reading_tick_ == tick); }
    const Reading& reading() const { return reading_; }

    void drive(const Drive& drive, std::uint64_t now_ns) {
        drive_ = drive;
        has_driven_ = true;
        has_reading_ = false;
        said_ns_ = now_ns;
        say_drive();
    }

    /// What waits to be sent: `sent` says how many of these bytes are on the way.
    const std::uint8_t* output() const { return output_; }
    std::size_t output_size() const { return output_size_; }
    void sent(std::size_t size) {
        output_size_ -= size;
        std::memmove(output_, output_ + size, output_size_);
    }

private:
    static constexpr std::uint64_t repeat_ns = 100'000'000;
    static constexpr std::uint8_t setup_type = 0x01;
    static constexpr std::uint8_t reading_type = 0x02;
    static constexpr std::uint8_t boot_type = 0x81;
    static constexpr std::uint8_t drive_type = 0x82;

    void handle(const std::uint8_t* payload, std::size_t size) {
        Reader reader(payload + 1, size - 1);
        if (payload[0] == setup_type && !has_driven_) {
            Settings settings = settings_;
            settings.period_ns = reader.take<std::uint32_t>();
            settings.batch_ticks = reader.take<std::uint8_t>();
            const auto mode = reader.take<std::uint8_t>();
            settings.mode = static_cast<CommandMode>(mode);
            settings.encoder_resolution = reader.take<double>();
            settings.widest = reader.take_limits();
            settings.max_following_error = reader.take<double>();
            if (reader.is_whole() && mode <= static_cast<std::uint8_t>(CommandMode::effort) &&
                settings.period_ns != 0 && settings.batch_ticks != 0 && settings.batch_ticks <= 100 &&
                settings.encoder_resolution > 0.0) {
                settings_ = settings;
                is_set_up_ = true;
            }
        } else if (payload[0] == reading_type && is_set_up_) {
            const auto tick = reader.take<std::uint64_t>();
            Reading now;
            now.counter = reader.take<std::uint32_t>();
            now.home_counter = reader.take<std::uint32_t>();
            now.effort = reader.take<float>();
            const auto flags = reader.take<std::uint8_t>();
            set_flags(now, flags);
            if (reader.is_whole() && (!has_driven_ || tick == drive_.tick + 1)) {
                reading_ = now;
                reading_tick_ = tick;
                has_reading_ = true;
            }
        }
    }

    void say_drive() {
        std::uint8_t payload[64];
        Writer message(payload);
        message.put(drive_type);
        message.put(drive_.tick);
        message.put(static_cast<std::uint8_t>((drive_.is_powered ? 1U : 0U) | (drive_.is_free ? 2U : 0U)));
        message.put(drive_.position);
        message.put(drive_.velocity);
        message.put(drive_.acceleration);
        message.put(drive_.effort);
        message.put(drive_.steps);
        say(payload, message.size());
    }

    void say(const std::uint8_t* payload, std::size_t size) {
        // One message is on the way at a time; a repeated one never overtakes it.
        if (output_size_ == 0) {
            output_size_ = encode_frame(payload, size, output_);
        }
    }

    Settings settings_;
    std::uint32_t boot_id_;
    FrameDecoder decoder_;
    bool is_set_up_ = false;
    bool has_reading_ = false;
    bool has_driven_ = false;
    std::uint64_t reading_tick_ = 0;
    Reading reading_;
    Drive drive_;
    std::uint64_t said_ns_ = 0;
    std::uint8_t output_[96] = {};
    std::size_t output_size_ = 0;
};

}  // namespace beam

#endif
