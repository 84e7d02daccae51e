// The host's requests and their answers: a request is done once, and answered as often as it is asked.

#ifndef BEAM_CORE_REQUESTS_HPP
#define BEAM_CORE_REQUESTS_HPP

#include <cstdint>

#include "text.hpp"
#include "transitions.hpp"

namespace beam {

enum class Phase : std::uint8_t { pending, success, failure };

struct Request {
    enum class Wait : std::uint8_t { nothing, home, rest };

    std::uint16_t number = 0;
    Cause kind = Cause::stop;
    Phase phase = Phase::pending;
    Wait wait = Wait::nothing;
    bool is_used = false;
    bool is_due = false;  ///< whether its answer waits to be sent
    Text text;

    void answer(Phase how, const Text& words) {
        phase = how;
        text = words;
        wait = Wait::nothing;
        is_due = true;
    }
};

/// The newest requests of a session.
class Requests {
public:
    static constexpr std::size_t remembered = 16;

    /// Returns the request of a number, or null.
    Request* find(std::uint16_t number) {
        for (Request& request : requests_) {
            if (request.is_used && request.number == number) {
                return &request;
            }
        }
        return nullptr;
    }

    /// Takes a new request in the place of the oldest.
    Request& begin(std::uint16_t number, Cause kind) {
        Request& request = requests_[next_];
        next_ = (next_ + 1) % remembered;
        request = Request{};
        request.number = number;
        request.kind = kind;
        request.is_used = true;
        return request;
    }

    void forget() {
        for (Request& request : requests_) {
            request = Request{};
        }
    }

    Request* begin() { return requests_; }
    Request* end() { return requests_ + remembered; }

private:
    Request requests_[remembered];
    std::size_t next_ = 0;
};

}  // namespace beam

#endif
