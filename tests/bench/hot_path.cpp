// SPDX-License-Identifier: Apache-2.0
#include "tests/bench/hot_path.hpp"

#include <fmt/format.h>

#include <utility>

#include "daemon/core/spare_buffers.hpp"
#include "tests/bench/allocations.hpp"

namespace slamgw::bench {
namespace {

using namespace std::chrono_literals;

const Now start{TimePoint{1h}, WallTime{1'700'000'000s}};
const TopicScheme scheme("ntnu-slam", "bench");
/// Robot (10, -20) cm, one obstacle at (100, 300), and the robots' stray octet.
const Bytes update{0x0a, 0x00, 0xec, 0xff, 0x64, 0x00, 0x2c, 0x01, 0x99};

std::string id_of(std::uint16_t client) { return fmt::format("load-{:05}", client); }

}  // namespace

HotPath::HotPath(std::uint16_t clients, Duration between)
    : clients_(clients),
      between_(between),
      now_(start),
      mesh_({}, TopicPolicy(scheme, {}, {}), RobotNames()),
      core_(scheme, {"0", UpdateMode::positions, now_.wall}, link_,
            [this](Mesh mesh, const std::string& robot) {
              return mesh == Mesh::thread ? mesh_.presence_of(robot) : std::nullopt;
            }),
      outbox_(16, 1 << 20) {
  outbox_.on_store_event(StoreAbsent{"none"}, now_.mono);
  outbox_.on_link_up(65535, now_.mono);
  for (std::uint16_t client = 0; client < clients; ++client) {
    const std::string id = id_of(client);
    on_datagram(client, mqttsn::Connect{false, true, mqttsn::protocol_id, 600, id});
    const std::string update_topic = scheme.robot_root() + id + "/update";
    on_datagram(client, mqttsn::Register{0, 1, update_topic});
    update_ids_.push_back(mqttsn::topic_id_of(update_topic));
    on_datagram(client, mqttsn::Subscribe{false, mqttsn::WireQos::one, mqttsn::TopicIdType::normal,
                                          2, scheme.command_topic(id, "target"), 0});
  }
}

std::uint16_t HotPath::next_client() {
  now_.mono += between_;
  return static_cast<std::uint16_t>(turn_++ % clients_);
}

void HotPath::publish(Qos qos) {
  const std::uint16_t client = next_client();
  const auto msg_id = static_cast<std::uint16_t>(turn_ / clients_ % 65535 + 1);
  on_datagram(client,
              mqttsn::Publish{false, static_cast<mqttsn::WireQos>(qos), false,
                              mqttsn::TopicIdType::normal, update_ids_[client], msg_id, update});
}

void HotPath::command() {
  const std::uint16_t client = next_client();
  on_robot_message(id_of(client), R"({"x":100,"y":300})");
  if (const auto command = std::exchange(command_, std::nullopt))
    on_datagram(client,
                mqttsn::Puback{command->topic_id, command->msg_id, mqttsn::ReturnCode::accepted});
}

void HotPath::ping() { on_datagram(next_client(), mqttsn::Pingreq{}); }

void HotPath::on_datagram(std::uint16_t client, const mqttsn::Packet& packet) {
  mqttsn::Endpoint from;
  from.address[15] = 1;
  from.port = static_cast<std::uint16_t>(1024 + client);
  Bytes datagram = mqttsn::encode(packet);
  const std::uint64_t before = bench::allocations();
  mesh_.on_datagram(from, {}, datagram, now_.mono);
  drain();
  allocations_ += bench::allocations() - before;
  SpareBuffers<Bytes>::give_back(std::move(datagram));
}

/// Sends a command as the robot's session does.
void HotPath::on_robot_message(const std::string& robot, std::string_view payload) {
  const std::uint64_t before = bench::allocations();
  core_.commands().on_robot_message(
      {robot,
       {scheme.command_topic(robot, "target"), to_bytes(payload), Qos::at_least_once, false}},
      now_);
  drain();
  allocations_ += bench::allocations() - before;
}

void HotPath::drain() {
  if (const auto due = mesh_.deadline(); due && *due <= now_.mono) mesh_.on_deadline(now_.mono);
  for (bool is_quiet = false; !is_quiet;) {
    is_quiet = true;
    for (; auto action = mesh_.next_action(); is_quiet = false) perform(*action);
    for (; auto action = core_.next_action(); is_quiet = false) perform(*action);
    for (; auto action = outbox_.next_action(); is_quiet = false) perform(*action);
  }
  constexpr std::size_t all = 1000;
  at_disk_ += mesh_.take_changed(all).size();
}

/// Sends like UdpSocket, which keeps the memory until its next datagram.
void HotPath::handle(mqttsn::SendDatagram& datagram) {
  ++sent_datagrams_;
  constexpr std::size_t type_at = 1;
  if (datagram.bytes.at(type_at) == static_cast<std::uint8_t>(mqttsn::MsgType::publish)) {
    const std::uint64_t before = bench::allocations();
    command_ = std::get<mqttsn::Publish>(*mqttsn::decode(datagram.bytes));
    allocations_ -= bench::allocations() - before;  // the client's
  }
  SpareBuffers<Bytes>::give_back(std::move(datagram.bytes));
}

/// Grants each subscription at once.
void HotPath::handle(MeshEvent& event) {
  if (const auto* subscribe = std::get_if<SubscribeRequest>(&event))
    mesh_.on_subscribe_result(subscribe->robot, subscribe->filter, true, now_.mono);
  core_.on_mesh_event(std::move(event), now_);
}

void HotPath::handle(PassUp& up) {
  Upload upload = up.upload();
  handle(upload);
}

void HotPath::handle(Upload& upload) {
  outbox_.submit(std::move(upload.message), upload.receipt, now_.mono);
}

void HotPath::handle(DeliverToMesh& delivery) {
  mesh_.on_broker_message(delivery.message, now_.mono);
}

void HotPath::handle(PublishAtBroker& publish) {
  ++at_broker_;
  outbox_.on_published(publish.sequence, now_.mono);
}

void HotPath::handle(FireReceipt& fired) {
  core_.on_receipt(fired.receipt, fired.outcome, now_.mono);
  if (fired.receipt.is_owed()) mesh_.on_receipt(fired.receipt.id, fired.outcome, now_.mono);
}

}  // namespace slamgw::bench
