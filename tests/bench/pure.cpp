// SPDX-License-Identifier: Apache-2.0
// The first layer of ./dev bench: the cost of pure code by itself, by Google Benchmark, and its
// allocations. No sockets, no threads; the clock of the machines stands still or is moved by hand.
#include <benchmark/benchmark.h>
#include <fmt/format.h>

#include "adapters/ble_mesh_usb_cdc/nordic/serial_protocol.hpp"
#include "adapters/mqttsn_udp/protocol/packet.hpp"
#include "adapters/mqttsn_udp/sn_gateway.hpp"
#include "daemon/core/gateway.hpp"
#include "daemon/core/normalizer.hpp"
#include "daemon/core/trace.hpp"
#include "daemon/delivery/outbox.hpp"
#include "tests/bench/hot_path.hpp"

namespace slamgw {
namespace {

using namespace std::chrono_literals;

/// Robot (10, -20) cm, one obstacle at (100, 300), and the robots' stray octet.
const Bytes update{0x0a, 0x00, 0xec, 0xff, 0x64, 0x00, 0x2c, 0x01, 0x99};
const TimePoint start{1h};

Bytes publish_from_client(std::uint16_t msg_id) {
  return mqttsn::encode(mqttsn::Publish{false, mqttsn::WireQos::one, false,
                                        mqttsn::TopicIdType::normal, 1, msg_id, update});
}

void decode_publish(benchmark::State& state) {
  const Bytes datagram = publish_from_client(7);
  for (auto _ : state) benchmark::DoNotOptimize(mqttsn::decode(datagram));
}
BENCHMARK(decode_publish);

void encode_puback(benchmark::State& state) {
  for (auto _ : state) benchmark::DoNotOptimize(mqttsn::encode(mqttsn::Puback{1, 7}));
}
BENCHMARK(encode_puback);

/// A robot's update to a group, as the board's event has it (length octet cut off).
void decode_board_event(benchmark::State& state) {
  const Bytes frame{0xd1, 0x00, 0x01, 0x01, 0x00, 0x00, 0x00, 0x00, 0x00, 0x08, 0x01,
                    0xc4, 0x3b, 0xf9, 0x0b, 0x6e, 0x01, 0xc4, 0x0c, 0x00, 0xc9, 0x59,
                    0x00, 0x0a, 0x00, 0xec, 0xff, 0x64, 0x00, 0x2c, 0x01, 0x00};
  if (!ble::decode_event(frame)) state.SkipWithError("the event is not read");
  for (auto _ : state) benchmark::DoNotOptimize(ble::decode_event(frame));
}
BENCHMARK(decode_board_event);

void normalize_update(benchmark::State& state) {
  for (auto _ : state) benchmark::DoNotOptimize(normalize("update", update, UpdateMode::positions));
}
BENCHMARK(normalize_update);

/// From a mesh's report to the upload and the traffic event; `range`: robots known.
void route_report(benchmark::State& state) {
  const Now now{start, WallTime{1'700'000'000s}};
  const BrokerLink link;
  Gateway gateway(TopicScheme("ntnu-slam", "bench"), {"0", UpdateMode::positions, now.wall}, link,
                  [](Mesh, const std::string&) { return std::nullopt; });
  std::vector<std::string> robots;
  for (std::int64_t i = 0; i < state.range(0); ++i) robots.push_back(fmt::format("load-{:05}", i));
  std::size_t next = 0;
  for (auto _ : state) {
    const std::string& robot = robots[next++ % robots.size()];
    gateway.on_mesh_event(Report{Mesh::thread, robot, "ntnu-slam/robot/" + robot + "/update",
                                 update, Qos::at_least_once, false, Receipt{Mesh::thread, 1}},
                          now);
    while (auto action = gateway.next_action()) benchmark::DoNotOptimize(*action);
  }
}
BENCHMARK(route_report)->Arg(10)->Arg(10000);

/// The cost of tracing for each message; `range`: whether tracing is on.
void trace_message(benchmark::State& state) {
  const Now now{start, WallTime{1'700'000'000s}};
  std::uint64_t reported = 0;
  Trace trace(
      TopicScheme("ntnu-slam", "bench"), [](const std::string&, Mesh) { return std::string(); },
      [&](const TraceEvent&) { ++reported; });
  trace.turn(state.range(0) != 0);
  TrafficEvent message{.mesh = Mesh::thread,
                       .robot = "load-00001",
                       .type = "update",
                       .topic = "ntnu-slam/robot/load-00001/update",
                       .payload = update,
                       .qos = Qos::at_least_once,
                       .update = {},
                       .receipt = {Mesh::thread, 1}};
  const MessageStep acknowledged{.kind = StepKind::acknowledged,
                                 .mesh = Mesh::thread,
                                 .robot = message.robot,
                                 .receipt = message.receipt};
  for (auto _ : state) {
    trace.on_traffic(message);
    trace.on_step(acknowledged, now);
    benchmark::DoNotOptimize(reported);
  }
}
BENCHMARK(trace_message)->Arg(0)->Arg(1);

/// Submitted, published, acknowledged, its receipt fired.
void outbox_and_receipt(benchmark::State& state) {
  Outbox outbox(16, 1 << 20);
  outbox.on_store_event(StoreAbsent{"none"}, start);
  outbox.on_link_up(65535, start);
  std::uint64_t sequence = 0;
  for (auto _ : state) {
    outbox.submit({"ntnu-slam/robot/load-00001/update", update, Qos::at_least_once, false, {}},
                  Receipt{Mesh::thread, 1}, start);
    while (auto action = outbox.next_action()) {
      if (auto* publish = std::get_if<PublishAtBroker>(&*action)) sequence = publish->sequence;
    }
    outbox.on_published(sequence, start);
    while (auto action = outbox.next_action()) benchmark::DoNotOptimize(*action);
  }
}
BENCHMARK(outbox_and_receipt);

/// `count` connected clients with a topic each.
class Clients {
 public:
  explicit Clients(std::uint16_t count)
      : gateway_({}, TopicPolicy(TopicScheme("ntnu-slam", "bench"), {}, {}), RobotNames()),
        count_(count) {
    for (std::uint16_t i = 0; i < count; ++i) {
      const std::string id = fmt::format("load-{:05}", i);
      say(i, mqttsn::encode(mqttsn::Connect{false, true, mqttsn::protocol_id, 600, id}));
      say(i, mqttsn::encode(mqttsn::Register{0, 1, "ntnu-slam/robot/" + id + "/update"}));
    }
  }
  /// A PUBLISH at QoS 1 and its PUBACK; each client in turn, time passing as at 5 000/s.
  void publish_and_acknowledge() {
    const auto client = static_cast<std::uint16_t>(turn_ % count_);
    const auto msg_id = static_cast<std::uint16_t>(turn_++ / count_ % 65535 + 1);
    now_ += 200us;
    say(client, publish_from_client(msg_id));
    gateway_.on_receipt(receipt_, ReceiptOutcome::safe, now_);
    drain();
  }

 private:
  void say(std::uint16_t client, const Bytes& datagram) {
    mqttsn::Endpoint from;
    from.address[15] = 1;
    from.port = static_cast<std::uint16_t>(1024 + client);
    gateway_.on_datagram(from, {}, datagram, now_);
    drain();
  }
  void drain() {
    if (const auto due = gateway_.deadline(); due && *due <= now_) gateway_.on_deadline(now_);
    while (auto action = gateway_.next_action()) {
      const auto* event = std::get_if<MeshEvent>(&*action);
      const auto* report = event ? std::get_if<Report>(event) : nullptr;
      if (report) receipt_ = report->receipt.id;
    }
    (void)gateway_.take_changed(1000);
  }

  mqttsn::SnGateway gateway_;
  const std::uint64_t count_;
  std::uint64_t turn_ = 0;
  std::uint64_t receipt_ = 0;
  TimePoint now_ = start;
};

void mqttsn_publish(benchmark::State& state) {
  Clients clients(static_cast<std::uint16_t>(state.range(0)));
  for (auto _ : state) clients.publish_and_acknowledge();
}
BENCHMARK(mqttsn_publish)->Arg(10)->Arg(1000)->Arg(10000);

/// From a client's PUBLISH to its PUBACK, wired as in App. `range`: QoS.
void publish_to_puback(benchmark::State& state) {
  bench::HotPath path(100, 30us);
  const auto qos = static_cast<Qos>(state.range(0));
  constexpr int until_warm = 100'000;
  for (int i = 0; i < until_warm; ++i) path.publish(qos);
  path.forget_allocations();
  for (auto _ : state) path.publish(qos);
  state.counters["allocations"] =
      static_cast<double>(path.allocations()) / static_cast<double>(state.iterations());
}
BENCHMARK(publish_to_puback)->Arg(0)->Arg(1);

/// From the broker's message to the PUBLISH, and from the client's PUBACK to the outcome at the
/// broker.
void command_to_outcome(benchmark::State& state) {
  bench::HotPath path(100, 30us);
  constexpr int until_warm = 10'000;
  for (int i = 0; i < until_warm; ++i) path.command();
  path.forget_allocations();
  for (auto _ : state) path.command();
  state.counters["allocations"] =
      static_cast<double>(path.allocations()) / static_cast<double>(state.iterations());
}
BENCHMARK(command_to_outcome);

}  // namespace
}  // namespace slamgw

BENCHMARK_MAIN();
