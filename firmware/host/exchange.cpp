// The core in somebody else's time: it reads what came by when, and answers what it sends.
//
//     beam-exchange MODE POSITION [ACCIDENT]
//
// Standard input: u64 now [ns], u32 size, bytes; standard output: u32 size, bytes; again and again. The ticks before
// `now` are done first, then the bytes are taken. From tick 5000 on there may be an accident: the encoder is lost or
// jumps, the hub sticks, an end switch closes, the drive reports an alarm, or the home switch never changes.

#include <cstdio>
#include <cstdlib>
#include <memory>
#include <vector>

#include "../core/core.hpp"
#include "../plant/default_rig.hpp"
#include "virtual_board.hpp"

int main(int argc, char** argv) {
    if (argc < 3 || argc > 4) {
        std::fputs("usage: beam-exchange MODE(0 to 3) POSITION [lost|jump|stuck|end|alarm|blind]\n", stderr);
        return 2;
    }
    beam::Settings settings = beam::default_rig();
    settings.mode = static_cast<beam::CommandMode>(std::atoi(argv[1]));
    beam::IdealAxis axis(settings, std::atof(argv[2]), 0.8);
    beam::VirtualBoard board(axis);
    board.accident = argc == 4 ? argv[3] : "";
    const auto core = std::make_unique<beam::Core>(board, settings);
    core->start();
    std::uint64_t now_ns = 0;
    std::uint32_t size = 0;
    std::vector<std::uint8_t> data;
    while (std::fread(&now_ns, sizeof now_ns, 1, stdin) == 1 && std::fread(&size, sizeof size, 1, stdin) == 1) {
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
        size = static_cast<std::uint32_t>(board.output.size());
        std::fwrite(&size, sizeof size, 1, stdout);
        std::fwrite(board.output.data(), 1, board.output.size(), stdout);
        std::fflush(stdout);
        board.output.clear();
    }
    return 0;
}
