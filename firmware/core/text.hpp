// Short sentences for people, without the C library's formatting and without a heap.

#ifndef BEAM_CORE_TEXT_HPP
#define BEAM_CORE_TEXT_HPP

#include <cmath>
#include <cstdint>

namespace beam {

/// A text of at most 200 bytes; what does not fit is cut off.
class Text {
public:
    static constexpr std::uint8_t longest = 200;

    Text() = default;
    Text(const char* words) { *this << words; }  // NOLINT: a text is made from words

    Text& operator<<(const char* words) {
        for (; *words != '\0'; ++words) {
            put(*words);
        }
        return *this;
    }

    Text& operator<<(const Text& other) {
        for (std::uint8_t i = 0; i < other.size_; ++i) {
            put(other.data_[i]);
        }
        return *this;
    }

    Text& operator<<(std::uint64_t number) {
        char digits[20];
        int n = 0;
        do {
            digits[n++] = static_cast<char>('0' + number % 10);
            number /= 10;
        } while (number != 0);
        while (n > 0) {
            put(digits[--n]);
        }
        return *this;
    }

    /// Appends a number with six decimals at most.
    Text& operator<<(double number) {
        if (std::isnan(number)) {
            return *this << "nan";
        }
        if (number < 0.0) {
            put('-');
            number = -number;
        }
        if (!(number < 1e12)) {
            return *this << "more than 1e12";
        }
        auto whole = static_cast<std::uint64_t>(number * 1e6 + 0.5);
        *this << whole / 1'000'000;
        std::uint64_t rest = whole % 1'000'000;
        if (rest == 0) {
            return *this;
        }
        char decimals[6];
        for (int k = 5; k >= 0; --k) {
            decimals[k] = static_cast<char>('0' + rest % 10);
            rest /= 10;
        }
        int n = 6;
        while (decimals[n - 1] == '0') {
            --n;
        }
        put('.');
        for (int k = 0; k < n; ++k) {
            put(decimals[k]);
        }
        return *this;
    }

    const char* data() const { return data_; }
    std::uint8_t size() const { return size_; }

private:
    void put(char letter) {
        if (size_ < longest) {
            data_[size_++] = letter;
        }
    }

    char data_[longest] = {};
    std::uint8_t size_ = 0;
};

}  // namespace beam

#endif
