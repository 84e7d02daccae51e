#include "core.hpp"

#include <cmath>
#include <cstring>

namespace beam {

namespace {

constexpr std::uint8_t version = 2;
constexpr char magic[] = "BEAM";
constexpr std::size_t magic_size = 4;

enum Type : std::uint8_t {
    hello = 0x01,
    heartbeat,
    clock_query,
    request,
    setpoint,
    arm,
    samples,
    goodbye,
    set_limits,
    identity = 0x81,
    clock_reply,
    request_reply,
    arm_reply,
    telemetry,
    status,
    limits_reply,
};

constexpr std::size_t most_samples = 100;
constexpr std::uint8_t n_requests = 5;

/// Telemetry is pushed until the host has been silent for this long.
constexpr std::uint64_t push_patience_ns = 1'000'000'000;
/// How often at most the device identifies itself to a host without a session.
constexpr std::uint64_t identify_interval_ns = 100'000'000;

}  // namespace

/// Keeps the tick's interrupt out for as long as it lives.
class Core::Hold {
public:
    explicit Hold(Board& board) : board_(board) { board_.hold_ticks(); }
    ~Hold() { board_.release_ticks(); }
    Hold(const Hold&) = delete;
    Hold& operator=(const Hold&) = delete;

private:
    Board& board_;
};

Core::Core(Board& board, const Settings& settings) : board_(board), settings_(settings), axis_(settings) {}

void Core::start() {
    const std::uint64_t now_ns = board_.clock_ns();
    const std::uint64_t period_ns = settings_.period_ns;
    axis_.start(now_ns / period_ns + (now_ns % period_ns != 0 ? 1 : 0), board_.measure(),
                board_.was_reset_by_watchdog());
    heard_ns_ = now_ns;
    tick_fed_ = axis_.next_tick();
}

bool Core::tick() {
    if (board_.clock_ns() < axis_.next_tick() * settings_.period_ns) {
        return false;
    }
    board_.drive(axis_.tick(board_.measure()));
    return true;
}

// From the host ------------------------------------------------------------------------------------------------

void Core::receive(const std::uint8_t* data, std::size_t size, std::uint64_t arrived_ns) {
    for (std::size_t i = 0; i < size; ++i) {
        const std::size_t payload_size = decoder_.feed(data[i]);
        if (payload_size != 0) {
            handle(decoder_.payload(), payload_size, arrived_ns);
        }
    }
}

/// Does what a payload asks for; one of an unknown type, or that does not fit its type, changes nothing.
void Core::handle(const std::uint8_t* payload, std::size_t size, std::uint64_t arrived_ns) {
    Reader reader(payload + 1, size - 1);
    // What the message says, before it is known whether it is whole.
    std::uint8_t small = 0;
    std::uint16_t number = 0;
    std::uint32_t count = 0;
    std::uint64_t start_ns = 0;
    double value = 0.0;
    Limits limits;
    bool is_whole = false;
    const auto type = static_cast<Type>(payload[0]);
    switch (type) {
    case hello:
        is_whole = size >= 1 + magic_size + 2 && std::memcmp(payload + 1, magic, magic_size) == 0;
        break;
    case heartbeat:
    case goodbye:
        is_whole = reader.is_whole();
        break;
    case clock_query:
        number = reader.take<std::uint16_t>();
        is_whole = reader.is_whole();
        break;
    case request:
        number = reader.take<std::uint16_t>();
        small = reader.take<std::uint8_t>();
        is_whole = reader.is_whole() && small < n_requests;
        break;
    case setpoint:
        number = reader.take<std::uint16_t>();
        value = reader.take<double>();
        is_whole = reader.is_whole() && number != 0;
        break;
    case arm:
        number = reader.take<std::uint16_t>();
        start_ns = reader.take<std::uint64_t>();
        count = reader.take<std::uint32_t>();
        is_whole = reader.is_whole() && number != 0;
        break;
    case samples:
        number = reader.take<std::uint16_t>();
        count = reader.take<std::uint32_t>();
        is_whole = !reader.is_short() && reader.left() != 0 && reader.left() % sizeof(double) == 0 &&
                   reader.left() <= most_samples * sizeof(double);
        break;
    case set_limits:
        number = reader.take<std::uint16_t>();
        limits = reader.take_limits();
        is_whole = reader.is_whole();
        break;
    default:
        break;
    }
    if (!is_whole) {
        return;
    }
    const std::uint64_t now_ns = board_.clock_ns();
    if (!is_in_session_ && type != hello) {
        // The host believes in a session that this device has forgotten: tell it.
        if (!has_identified_ || now_ns - identified_ns_ > identify_interval_ns) {
            send_identity(version);
        }
        return;
    }
    if (type == clock_query) {
        // At once: what is done before the reply leaves makes the round trip longer.
        Writer message(payload_);
        message.put(clock_reply);
        message.put(number);
        message.put(arrived_ns);
        message.put(board_.clock_ns());
        send(message);
        write();
    }
    const Hold hold(board_);
    heard_ns_ = now_ns;
    axis_.feed();
    switch (type) {
    case hello:
        open_session(payload[1 + magic_size], payload[2 + magic_size]);
        break;
    case goodbye:
        axis_.emergency_stop(Fault::session_closed, "the host closed the session");
        send_status();
        is_in_session_ = false;
        break;
    case request:
        answer_request(number, small);
        break;
    case setpoint:
        take_setpoint(number, value);
        break;
    case arm:
        answer_arm(number, start_ns, count);
        break;
    case samples:
        take_samples(number, count, reader);
        break;
    case set_limits: {
        axis_.obey(limits);
        Writer message(payload_);
        message.put(limits_reply);
        message.put(number);
        message.put(axis_.limits());
        send(message);
        break;
    }
    default:
        break;
    }
}

void Core::open_session(std::uint8_t lowest, std::uint8_t highest) {
    const bool is_spoken = lowest <= version && version <= highest;
    axis_.emergency_stop(Fault::session_opened, "a host opened a new session");
    axis_.forget_session();
    has_arm_reply_ = false;
    setpoint_number_ = 0;
    is_in_session_ = is_spoken;
    send_identity(is_spoken ? version : 0);
    send_status();
}

void Core::answer_request(std::uint16_t number, std::uint8_t kind) {
    Request* known = axis_.requests.find(number);
    if (known == nullptr) {
        known = &axis_.requests.begin(number, static_cast<Cause>(kind));
        axis_.ask(*known);
    }
    known->is_due = true;
}

void Core::take_setpoint(std::uint16_t number, double value) {
    if (number == setpoint_number_) {
        return;
    }
    setpoint_number_ = number;
    if (!axis_.take_setpoint(value)) {
        ++setpoints_refused_;
        send_status();
    }
}

void Core::answer_arm(std::uint16_t number, std::uint64_t start_ns, std::uint32_t n_samples) {
    if (!has_arm_reply_ || arm_number_ != number) {
        has_arm_reply_ = true;
        arm_number_ = number;
        is_arm_accepted_ = axis_.arm(number, start_ns, n_samples, arm_answer_);
    }
    send_arm_reply();
    send_status();
}

/// Takes what continues the sequence; the status tells the host what is still missing.
void Core::take_samples(std::uint16_t number, std::uint32_t first, Reader& reader) {
    SampleRing& ring = axis_.ring;
    const auto n = static_cast<std::uint32_t>(reader.left() / sizeof(double));
    const std::uint32_t known = ring.n_received() - first;
    if (number == axis_.sequence_number() && axis_.has_sequence() && first <= ring.n_received() && known < n) {
        const std::uint32_t n_new = n - known < ring.free() ? n - known : ring.free();
        for (std::uint32_t k = 0; k < known; ++k) {
            reader.take<double>();
        }
        // What goes on after the sequence's end is of no sequence.
        const bool is_of_sequence = n_new <= ring.n_missing();
        for (std::uint32_t k = 0; is_of_sequence && k < n_new; ++k) {
            ring.append(reader.take<double>());
        }
    }
    send_status();
}

// To the host --------------------------------------------------------------------------------------------------

void Core::poll() {
    {
        const Hold hold(board_);
        if (axis_.next_tick() != tick_fed_) {
            tick_fed_ = axis_.next_tick();
            board_.feed_watchdog();
        }
        for (Request& request : axis_.requests) {
            if (request.is_used && request.is_due) {
                request.is_due = false;
                send_reply(request);
            }
        }
        if (axis_.changes() != changes_sent_) {
            send_status();
        }
        if (!is_in_session_ || board_.clock_ns() - heard_ns_ > push_patience_ns) {
            axis_.telemetry.clear();
        }
    }
    while (send_batch()) {
        const Hold hold(board_);
        send_status();
    }
    write();
}

void Core::send_identity(std::uint8_t spoken) {
    identified_ns_ = board_.clock_ns();
    has_identified_ = true;
    Writer message(payload_);
    message.put(identity);
    message.put_bytes(magic, magic_size);
    message.put(spoken);
    message.put(version);
    message.put(version);
    message.put(board_.boot_id());
    if (spoken != 0) {
        message.put(settings_.period_ns);
        message.put(settings_.batch_ticks);
        message.put(SampleRing::capacity);
        message.put(settings_.mode);
        message.put(settings_.encoder_resolution);
        message.put(settings_.widest);
        message.put(Text(settings_.name));
    }
    send(message);
}

void Core::send_status() {
    changes_sent_ = axis_.changes();
    if (!is_in_session_) {
        return;
    }
    const Appearance now = axis_.appearance();
    Writer message(payload_);
    message.put(status);
    message.put(board_.boot_id());
    message.put(axis_.next_tick());
    message.put(now.state);
    message.put(now.activity);
    message.put(axis_.position_count());
    message.put(axis_.velocity_count());
    message.put(axis_.fault());
    message.put(axis_.silences());
    message.put(axis_.silence_tick());
    message.put(setpoint_number_);
    message.put(setpoints_refused_);
    message.put(axis_.sequence_number());
    message.put(axis_.sequence_state());
    message.put(axis_.ring.n_received());
    message.put(axis_.ring.free());
    message.put(axis_.reason());
    message.put(axis_.sequence_reason());
    send(message);
}

void Core::send_reply(const Request& request) {
    Writer message(payload_);
    message.put(request_reply);
    message.put(request.number);
    message.put(request.phase);
    message.put(request.text);
    send(message);
}

void Core::send_arm_reply() {
    Writer message(payload_);
    message.put(arm_reply);
    message.put(arm_number_);
    message.put(static_cast<std::uint8_t>(is_arm_accepted_ ? 1 : 0));
    message.put(arm_answer_);
    send(message);
}

/// Sends the oldest batch if there is a whole one. Ticks may go on meanwhile: where there is no more room they throw away
/// what waits, so nothing that was seen before they are held counts.
bool Core::send_batch() {
    const std::uint32_t n = settings_.batch_ticks;
    Writer message(payload_);
    {
        const Hold hold(board_);
        const Telemetry& waiting = axis_.telemetry;
        if (waiting.size() < n) {
            return false;
        }
        message.put(telemetry);
        message.put(waiting.first_tick());
        message.put(settings_.batch_ticks);
        for (std::uint32_t k = 0; k < n; ++k) {
            message.put(waiting[k].applied);
        }
        for (std::uint32_t k = 0; k < n; ++k) {
            message.put(waiting[k].position);
        }
        for (std::uint32_t k = 0; k < n; ++k) {
            message.put(waiting[k].velocity);
        }
        for (std::uint32_t k = 0; k < n; ++k) {
            message.put(waiting[k].effort);
        }
        axis_.telemetry.drop(n);
    }
    send(message);
    return true;
}

/// Puts a message on the way as one frame; where the line takes no more, it is left out.
void Core::send(const Writer& message) {
    const std::size_t size = encode_frame(payload_, message.size(), frame_);
    if (output_used_ + size > output_size) {
        return;
    }
    std::size_t end = (output_begin_ + output_used_) % output_size;
    for (std::size_t i = 0; i < size; ++i) {
        output_[end] = frame_[i];
        end = end + 1 == output_size ? 0 : end + 1;
    }
    output_used_ += size;
}

void Core::write() {
    while (output_used_ != 0) {
        const std::size_t to_end = output_size - output_begin_;
        const std::size_t size = output_used_ < to_end ? output_used_ : to_end;
        const std::size_t taken = board_.write(output_ + output_begin_, size);
        output_begin_ = (output_begin_ + taken) % output_size;
        output_used_ -= taken;
        if (taken < size) {
            return;
        }
    }
}

}  // namespace beam
