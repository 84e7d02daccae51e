// The core in somebody else's time: it reads what came by when, and answers what it sends.
//
//     beam-exchange MODE POSITION
//
// Standard input: u64 now [ns], what the sensors read (`Interference`: u8 signals that are on, u8 signals that are off,
// as the flags of the plant port; u8 whether the hub is stuck, i32 by how much the counter is wrong), u32 size, bytes.
// Standard output: f64 where the hub is, seen from its home [m], u32 size, bytes. Again and again. The ticks before
// `now` are done first, then the bytes are taken.

#include <cstdio>
#include <cstdlib>
#include <memory>
#include <vector>

#include "../core/core.hpp"
#include "../plant/default_rig.hpp"
#include "virtual_board.hpp"

namespace {

template <typename Number>
bool take(Number& value) {
    return std::fread(&value, sizeof value, 1, stdin) == 1;
}

}  // namespace

int main(int argc, char** argv) {
    if (argc != 3) {
        std::fputs("usage: beam-exchange MODE(0 to 3) POSITION\n", stderr);
        return 2;
    }
    beam::Settings settings = beam::default_rig();
    settings.mode = static_cast<beam::CommandMode>(std::atoi(argv[1]));
    beam::IdealAxis axis(settings, std::atof(argv[2]), 0.8);
    beam::VirtualBoard board(axis);
    const auto core = std::make_unique<beam::Core>(board, settings);
    core->start();
    std::uint64_t now_ns = 0;
    std::uint32_t size = 0;
    std::vector<std::uint8_t> data;
    beam::Interference& wrong = board.interference;
    while (take(now_ns) && take(wrong.on) && take(wrong.off) && take(wrong.is_stuck) && take(wrong.counts) && take(size)) {
        data.resize(size);
        if (size != 0 && std::fread(data.data(), 1, size, stdin) != size) {
            return 1;
        }
        while (core->next_tick() * settings.period_ns < now_ns) {
            board.now_ns = core->next_tick() * settings.period_ns;
            core->tick();
            core->poll();
        }
        board.now_ns = now_ns;
        core->receive(data.data(), data.size(), now_ns);
        core->poll();
        const double position = axis.position();
        size = static_cast<std::uint32_t>(board.output.size());
        std::fwrite(&position, sizeof position, 1, stdout);
        std::fwrite(&size, sizeof size, 1, stdout);
        std::fwrite(board.output.data(), 1, board.output.size(), stdout);
        std::fflush(stdout);
        board.output.clear();
    }
    return 0;
}
