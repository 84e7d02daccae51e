// A stepper axis on a Teensy 4 or another 32-bit Arduino board: step and direction out, home and end switches in.
//
// NOT TRIED ON HARDWARE. It compiles against a stub of the Arduino functions, and nothing more is known of it. The core
// is the one that the host build and the STM32F405 run; what is untried are these pins, this clock and these pulses.
//
// It has no encoder: what it reports as measured is the steps that it has made. A motor that loses steps is not seen.
//
// `make -C firmware arduino` lays out build/beam_axis, a sketch folder with the core, for the Arduino IDE.

#include <Arduino.h>

#include "src/core/core.hpp"
#include "src/plant/default_rig.hpp"

static_assert(sizeof(double) == 8, "the path is kept in double precision: use a 32-bit board, no AVR");

namespace {

constexpr int step_pin = 2;
constexpr int direction_pin = 3;
constexpr int enable_pin = 4;  // low: the drive has current; it floats at a reset, and wants a pull-up outside
constexpr int home_pin = 5;    // high on the negative side of home
constexpr int low_end_pin = 6;
constexpr int high_end_pin = 7;
constexpr int alarm_pin = 8;  // all inputs close to ground while all is well: a cut wire reads as a hit or an alarm
constexpr double step_length = 5e-6;  // one step [m]
constexpr std::uint32_t pulse_us = 2;

class ArduinoBoard final : public beam::Board {
public:
    void begin() {
        // Before the pin drives: it would be low, and the drive on.
        digitalWrite(enable_pin, HIGH);
        for (int pin : {enable_pin, step_pin, direction_pin}) {
            pinMode(pin, OUTPUT);
        }
        for (int pin : {home_pin, low_end_pin, high_end_pin, alarm_pin}) {
            pinMode(pin, INPUT_PULLUP);
        }
        // Two starts hardly read the same noise; a board with a random number generator has better.
        boot_id_ = static_cast<std::uint32_t>(micros()) ^ (static_cast<std::uint32_t>(analogRead(0)) << 20U);
    }

    std::uint64_t clock_ns() override {
        const auto now_us = static_cast<std::uint32_t>(micros());
        us_ += now_us - last_us_;
        last_us_ = now_us;
        return us_ * 1000U;
    }
    std::uint32_t boot_id() override { return boot_id_; }
    bool was_reset_by_watchdog() override { return false; }

    std::size_t write(const std::uint8_t* data, std::size_t size) override {
        const auto room = static_cast<std::size_t>(Serial.availableForWrite());
        return Serial.write(data, size < room ? size : room);
    }

    beam::Reading measure() override {
        beam::Reading reading;
        reading.counter = static_cast<std::uint32_t>(made_);
        reading.home_counter = home_counter_;
        reading.has_home_counter = has_home_counter_;
        reading.is_below_home = is_below_home_;
        reading.is_at_low_end = digitalRead(low_end_pin) == HIGH;
        reading.is_at_high_end = digitalRead(high_end_pin) == HIGH;
        reading.has_drive_alarm = digitalRead(alarm_pin) == HIGH;
        return reading;
    }

    void drive(const beam::Drive& drive) override {
        digitalWrite(enable_pin, drive.is_powered ? LOW : HIGH);
        owed_ += drive.steps;
        const std::int32_t count = owed_ < 0 ? -owed_ : owed_;
        pause_us_ = 1000U / (static_cast<std::uint32_t>(count) + 1U);
        digitalWrite(direction_pin, owed_ < 0 ? LOW : HIGH);
    }

    /// Makes a step when one is due, and watches the home switch: call it as often as possible.
    void turn() {
        const auto now_us = static_cast<std::uint32_t>(micros());
        if (owed_ != 0 && now_us - stepped_us_ >= pause_us_) {
            stepped_us_ = now_us;
            digitalWrite(step_pin, HIGH);
            delayMicroseconds(pulse_us);
            digitalWrite(step_pin, LOW);
            made_ += owed_ < 0 ? -1 : 1;
            owed_ += owed_ < 0 ? 1 : -1;
        }
        const bool is_below = digitalRead(home_pin) == HIGH;
        if (is_below != is_below_home_) {
            is_below_home_ = is_below;
            home_counter_ = static_cast<std::uint32_t>(made_);
            has_home_counter_ = true;
        }
    }

    void feed_watchdog() override {}
    void hold_ticks() override {}
    void release_ticks() override {}

private:
    std::uint32_t boot_id_ = 0;
    std::uint64_t us_ = 0;
    std::uint32_t last_us_ = 0;
    std::int32_t made_ = 0;
    std::int32_t owed_ = 0;
    std::uint32_t pause_us_ = 0;
    std::uint32_t stepped_us_ = 0;
    std::uint32_t home_counter_ = 0;
    bool has_home_counter_ = false;
    bool is_below_home_ = false;
};

beam::Settings settings() {
    beam::Settings settings = beam::default_rig();
    settings.name = "beam firmware, Arduino";
    settings.encoder_resolution = settings.step_length = step_length;
    settings.widest.max_speed = 0.2;  // 40 steps in a tick
    settings.widest.max_acceleration = settings.widest.stop_deceleration = 5.0;
    settings.max_following_error = 0.0;
    return settings;
}

ArduinoBoard board;
beam::Core core(board, settings());

}  // namespace

void setup() {
    Serial.begin(921600);
    board.begin();
    core.start();
}

void loop() {
    board.turn();
    core.tick();
    std::uint8_t data[64];
    std::size_t size = 0;
    const std::uint64_t arrived_ns = board.clock_ns();
    while (size < sizeof data && Serial.available() > 0) {
        data[size++] = static_cast<std::uint8_t>(Serial.read());
    }
    core.receive(data, size, arrived_ns);
    core.poll();
}
