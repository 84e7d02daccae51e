// The few Arduino functions that the sketch calls, declared and nowhere defined: enough to see that it compiles.

#ifndef BEAM_ARDUINO_STUB_H
#define BEAM_ARDUINO_STUB_H

#include <cstddef>
#include <cstdint>

enum { LOW, HIGH, OUTPUT, INPUT_PULLUP };

void pinMode(int pin, int mode);
void digitalWrite(int pin, int level);
int digitalRead(int pin);
int analogRead(int pin);
unsigned long micros();
void delayMicroseconds(unsigned us);
void setup();
void loop();

struct SerialPort {
    void begin(unsigned long baud);
    int available();
    int availableForWrite();
    int read();
    std::size_t write(const std::uint8_t* data, std::size_t size);
};
extern SerialPort Serial;

#endif
