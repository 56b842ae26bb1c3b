// Receives tracked lines from `python -m frontend.run --publish tcp://127.0.0.1:5555`; docs/protocol.md has the fields.
//
//     g++ -std=c++17 -O2 receive_live_tracks.cpp -lzmq -o receive_live_tracks    # libzmq3-dev, nlohmann-json3-dev
//     ./receive_live_tracks tcp://127.0.0.1:5555

#include <zmq.h>

#include <chrono>
#include <cstdint>
#include <cstdio>
#include <cstring>
#include <nlohmann/json.hpp>
#include <vector>

using nlohmann::json;

// The values of an array, row by row. The types are those of docs/protocol.md, in the byte order of this machine.
template <typename T>
std::vector<T> column(const json& message, const char* name) {
    const auto& data = message.at("arrays").at(name).at("data").get_binary();
    std::vector<T> values(data.size() / sizeof(T));
    std::memcpy(values.data(), data.data(), values.size() * sizeof(T));
    return values;
}

int main(int count, char** arguments) {
    const char* address = count > 1 ? arguments[1] : "tcp://127.0.0.1:5555";
    void* context = zmq_ctx_new();
    void* socket = zmq_socket(context, ZMQ_SUB);
    zmq_setsockopt(socket, ZMQ_SUBSCRIBE, "", 0);
    if (zmq_connect(socket, address) != 0) return std::fprintf(stderr, "cannot connect to %s\n", address), 2;

    std::int64_t last = -1, lost = 0;
    zmq_msg_t part;
    zmq_msg_init(&part);
    while (zmq_msg_recv(&part, socket, 0) >= 0) {
        const auto* begin = static_cast<const std::uint8_t*>(zmq_msg_data(&part));
        const json message = json::from_msgpack(begin, begin + zmq_msg_size(&part));
        if (message.at("version") != 1) return std::fprintf(stderr, "another version of the protocol\n"), 2;
        const std::int64_t sequence = message.at("sequence");
        if (last >= 0) lost += sequence - last - 1;
        last = sequence;
        if (message.at("type") == "end") break;

        const auto ids = column<std::int64_t>(message, "ids");
        const auto states = column<std::uint8_t>(message, "states");
        const auto lines = column<float>(message, "segments_normalized");  // x0 y0 x1 y1 of each
        const bool stereo = message.at("arrays").contains("segments_m");  // not of older publishers
        const auto metres = stereo ? column<float>(message, "segments_m") : std::vector<float>();
        const std::int64_t now = std::chrono::nanoseconds(std::chrono::system_clock::now().time_since_epoch()).count();
        std::printf("%lld: %zu tracks, %.1f ms\n", static_cast<long long>(message.at("stamp_ns").get<std::int64_t>()),
                    ids.size(), (now - message.at("read_ns").get<std::int64_t>()) / 1e6);
        for (std::size_t k = 0; k < ids.size() && k < 3; ++k)
            if (states[k] == 1) {  // confirmed
                std::printf("  %lld: (%.4f, %.4f) - (%.4f, %.4f)\n", static_cast<long long>(ids[k]), lines[4 * k],
                            lines[4 * k + 1], lines[4 * k + 2], lines[4 * k + 3]);
                if (!metres.empty())  // a right image, NaN without depth; x0 y0 z0 x1 y1 z1 of each
                    std::printf("    %.2f and %.2f m away\n", metres[6 * k + 2], metres[6 * k + 5]);
            }
    }
    std::printf("received up to message %lld, lost %lld\n", static_cast<long long>(last), static_cast<long long>(lost));
    zmq_msg_close(&part), zmq_close(socket), zmq_ctx_term(context);
}
