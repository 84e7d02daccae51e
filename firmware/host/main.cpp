// The firmware as a Linux program: the core in real time on a pseudo-terminal or a TCP port.
//
//     beam-firmware [--listen PORT] [--plant PORT] [--mode MODE] [--position METRES]
//
// It prints one line for each end that can be opened ("host URL", "plant URL"), and runs until it or the program that
// started it is ended. Without --plant an ideal axis stands behind it, with a rigid mass.

#include <arpa/inet.h>
#include <fcntl.h>
#include <netinet/tcp.h>
#include <poll.h>
#include <pty.h>
#include <sys/socket.h>
#include <termios.h>
#include <unistd.h>

#include <cerrno>
#include <csignal>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <ctime>
#include <memory>
#include <string>

#include "../core/core.hpp"
#include "../plant/default_rig.hpp"
#include "../plant/ideal_axis.hpp"
#include "../plant/plant_port.hpp"

namespace {

constexpr double ideal_mass = 0.8;
constexpr std::size_t chunk = 4096;

[[noreturn]] void fail(const std::string& what) {
    std::fprintf(stderr, "beam-firmware: %s: %s\n", what.c_str(), std::strerror(errno));
    std::exit(2);
}

std::uint64_t steady_ns() {
    timespec now{};
    clock_gettime(CLOCK_MONOTONIC, &now);
    return static_cast<std::uint64_t>(now.tv_sec) * 1'000'000'000U + static_cast<std::uint64_t>(now.tv_nsec);
}

/// One end of a stream of bytes: a TCP port with one partner at a time, or a pseudo-terminal.
class Stream {
public:
    /// Waits for a partner on a port of this machine; 0: one that is free.
    explicit Stream(int port) {
        listener_ = socket(AF_INET, SOCK_STREAM | SOCK_NONBLOCK | SOCK_CLOEXEC, 0);
        const int yes = 1;
        setsockopt(listener_, SOL_SOCKET, SO_REUSEADDR, &yes, sizeof yes);
        sockaddr_in address{};
        address.sin_family = AF_INET;
        address.sin_port = htons(static_cast<std::uint16_t>(port));
        address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
        socklen_t size = sizeof address;
        auto* plain = reinterpret_cast<sockaddr*>(&address);
        if (listener_ < 0 || bind(listener_, plain, size) != 0 || listen(listener_, 1) != 0 ||
            getsockname(listener_, plain, &size) != 0) {
            fail("port " + std::to_string(port));
        }
        url_ = "socket://127.0.0.1:" + std::to_string(ntohs(address.sin_port));
    }

    /// Opens a pseudo-terminal.
    Stream() {
        char name[128];
        if (openpty(&partner_, &slave_, name, nullptr, nullptr) != 0) {
            fail("no pseudo-terminal");
        }
        termios raw{};
        tcgetattr(slave_, &raw);
        cfmakeraw(&raw);
        tcsetattr(slave_, TCSANOW, &raw);
        fcntl(partner_, F_SETFL, O_NONBLOCK);
        url_ = name;
    }

    ~Stream() {
        for (int descriptor : {partner_, slave_, listener_}) {
            if (descriptor >= 0) {
                close(descriptor);
            }
        }
    }
    Stream(const Stream&) = delete;
    Stream& operator=(const Stream&) = delete;

    const std::string& url() const { return url_; }
    int watched() const { return partner_ >= 0 ? partner_ : listener_; }

    /// Reads what is there; returns how many bytes.
    std::size_t read(std::uint8_t* data, std::size_t size) {
        if (partner_ < 0) {
            partner_ = accept4(listener_, nullptr, nullptr, SOCK_NONBLOCK | SOCK_CLOEXEC);
            const int yes = 1;
            setsockopt(partner_, IPPROTO_TCP, TCP_NODELAY, &yes, sizeof yes);
            return 0;
        }
        const ssize_t n = ::read(partner_, data, size);
        if (n == 0 || (n < 0 && errno != EAGAIN && errno != EINTR && errno != EIO)) {
            lose();
        }
        return n > 0 ? static_cast<std::size_t>(n) : 0;
    }

    /// Writes what fits; without a partner everything is lost, as on a line that nobody holds.
    std::size_t write(const std::uint8_t* data, std::size_t size) {
        if (partner_ < 0) {
            return size;
        }
        const ssize_t n = ::write(partner_, data, size);
        if (n < 0 && errno != EAGAIN && errno != EINTR) {
            lose();
            return size;
        }
        return n > 0 ? static_cast<std::size_t>(n) : 0;
    }

private:
    void lose() {
        if (listener_ >= 0 && partner_ >= 0) {
            close(partner_);
            partner_ = -1;
        }
    }

    int listener_ = -1;
    int partner_ = -1;
    int slave_ = -1;
    std::string url_;
};

class HostBoard final : public beam::Board {
public:
    HostBoard(Stream& line, beam::PlantPort* port, beam::IdealAxis* axis)
        : line_(line), port_(port), axis_(axis), start_ns_(steady_ns()) {}

    std::uint64_t clock_ns() override { return steady_ns() - start_ns_; }
    std::uint32_t boot_id() override { return static_cast<std::uint32_t>(start_ns_ / 1'000'000U) ^ static_cast<std::uint32_t>(getpid()); }
    bool was_reset_by_watchdog() override { return false; }
    std::size_t write(const std::uint8_t* data, std::size_t size) override { return line_.write(data, size); }
    beam::Reading measure() override { return axis_ != nullptr ? axis_->measure() : port_->reading(); }
    void drive(const beam::Drive& drive) override {
        if (axis_ != nullptr) {
            axis_->drive(drive);
        } else {
            port_->drive(drive, clock_ns());
        }
    }
    void feed_watchdog() override {}
    void hold_ticks() override {}
    void release_ticks() override {}

    bool is_ready(std::uint64_t tick) const { return axis_ != nullptr || port_->has_reading(tick); }

private:
    Stream& line_;
    beam::PlantPort* port_;
    beam::IdealAxis* axis_;
    std::uint64_t start_ns_;
};

/// Moves the bytes of the plant in both directions, and waits for a moment or for more of them.
void serve(Stream* plant, beam::PlantPort& port, int other, std::uint64_t now_ns, std::uint64_t wait_ns) {
    pollfd watched[2] = {{other, POLLIN, 0}, {plant != nullptr ? plant->watched() : -1, POLLIN, 0}};
    if (plant != nullptr && port.output_size() != 0) {
        port.sent(plant->write(port.output(), port.output_size()));
    }
    const timespec wait{static_cast<time_t>(wait_ns / 1'000'000'000U), static_cast<long>(wait_ns % 1'000'000'000U)};
    ppoll(watched, 2, &wait, nullptr);
    if (plant != nullptr) {
        std::uint8_t data[chunk];
        if (watched[1].revents != 0) {
            port.receive(data, plant->read(data, sizeof data));
        }
        port.poll(now_ns);
    }
}

struct Options {
    int listen = -1;
    int plant = -1;
    beam::CommandMode mode = beam::CommandMode::acceleration;
    double position = 0.0;
};

Options read_options(int argc, char** argv) {
    Options options;
    const std::string modes[] = {"acceleration", "velocity", "position", "effort"};
    for (int i = 1; i + 1 < argc; i += 2) {
        const std::string name = argv[i];
        const std::string value = argv[i + 1];
        if (name == "--listen") {
            options.listen = std::atoi(value.c_str());
        } else if (name == "--plant") {
            options.plant = std::atoi(value.c_str());
        } else if (name == "--position") {
            options.position = std::atof(value.c_str());
        } else if (name == "--mode") {
            for (std::uint8_t k = 0; k < 4; ++k) {
                if (value == modes[k]) {
                    options.mode = static_cast<beam::CommandMode>(k);
                }
            }
        } else {
            errno = EINVAL;
            fail(name + " (expected --listen, --plant, --mode or --position, each with a value)");
        }
    }
    return options;
}

}  // namespace

int main(int argc, char** argv) {
    std::signal(SIGPIPE, SIG_IGN);
    std::signal(SIGHUP, SIG_DFL);
    const Options options = read_options(argc, argv);
    const pid_t parent = getppid();
    const auto line = options.listen < 0 ? std::make_unique<Stream>() : std::make_unique<Stream>(options.listen);
    const auto plant = options.plant < 0 ? nullptr : std::make_unique<Stream>(options.plant);
    std::printf("host %s\n", line->url().c_str());
    if (plant) {
        std::printf("plant %s\n", plant->url().c_str());
    }
    std::fflush(stdout);

    beam::Settings settings = beam::default_rig();
    settings.name = "beam firmware, host build";
    settings.mode = options.mode;
    beam::PlantPort port(settings, static_cast<std::uint32_t>(getpid()));
    while (plant && !port.is_set_up() && getppid() == parent) {
        serve(plant.get(), port, -1, steady_ns(), 20'000'000);
    }
    beam::IdealAxis axis(port.settings(), options.position, ideal_mass);
    HostBoard board(*line, &port, plant ? nullptr : &axis);
    const auto core = std::make_unique<beam::Core>(board, port.settings());
    core->start();
    while (getppid() == parent) {
        while (board.is_ready(core->next_tick()) && core->tick()) {
            core->poll();
        }
        std::uint8_t data[chunk];
        const std::uint64_t arrived_ns = board.clock_ns();
        core->receive(data, line->read(data, sizeof data), arrived_ns);
        core->poll();
        const std::uint64_t due_ns = core->next_tick() * port.settings().period_ns;
        const std::uint64_t now_ns = board.clock_ns();
        serve(plant.get(), port, line->watched(), now_ns, due_ns > now_ns ? due_ns - now_ns : plant ? 100'000 : 0);
    }
}
