// SPDX-License-Identifier: Apache-2.0
#include "adapters/mqttsn_udp/io/mqttsn_adapter.hpp"

#include <fmt/format.h>

#include <stdexcept>
#include <utility>

#include "adapters/mqttsn_udp/io/interface_addresses.hpp"

namespace slamgw::mqttsn {
namespace {

namespace asio = boost::asio;

/// After the kernel says that an interface has changed: more will have changed by then.
constexpr std::chrono::milliseconds change_settles{100};
/// Where the kernel does not say; and it may drop what it says.
constexpr std::chrono::seconds watch_interval{10};
constexpr const char* interface_advice =
    ": the Thread border router makes it, see systemctl status otbr-agent (older ones: wpantund); "
    "another name goes into mqttsn.interface";

}  // namespace

MqttsnAdapter::MqttsnAdapter(asio::io_context& io, Settings settings, TopicPolicy policy,
                             RobotNames names, MeshListener& listener, SessionStore* sessions)
    : settings_(std::move(settings)),
      listener_(listener),
      io_(io),
      gateway_(settings_, std::move(policy), std::move(names)),
      driver_(io, gateway_, [this](Action& action) { perform(action); }),
      interface_watch_(std::make_shared<InterfaceWatch>(io)),
      watch_timer_(io) {
  if (sessions) keeper_.emplace(io, gateway_, *sessions);
}

/// Each input may change sessions; what time alone changes shows in an event (perform).
template <class Change>
void MqttsnAdapter::input(Change&& change) {
  driver_.input(std::forward<Change>(change));
  if (keeper_) keeper_->look();
}

void MqttsnAdapter::start() {
  if (keeper_) {
    const SessionKeeper::Restored restored = keeper_->restore(read_clocks().mono);
    if (!restored.text.empty())
      listener_.on_mesh_event(Notice{restored.severity, restored.text, {}});
  }
  interface_index_ = interface_index(settings_.interface);
  if (settings_.interface.empty() || interface_index_ != 0) {
    open();
  } else {
    tell_link(false, "there is no interface " + settings_.interface + " yet" + interface_advice);
  }
  interface_watch_->start([this] { look_at_interfaces_in(change_settles); });
  watch_interfaces();
  input([](SnGateway&, TimePoint) {});  // what restored sessions have to say
}

void MqttsnAdapter::stop_listening() {
  for (const auto& socket : sockets_) socket->stop_receiving();
  input([](SnGateway& gateway, TimePoint now) { gateway.on_stop(now); });
}

/// No goodbye: clients are to notice nothing of a restart.
void MqttsnAdapter::stop() {
  driver_.stop();
  if (keeper_) keeper_->stop();
  interface_watch_->stop();
  watch_timer_.cancel();
  close();
}

void MqttsnAdapter::open() {
  std::string where;
  for (const std::string& listen : settings_.listen) {
    const auto index = static_cast<std::uint8_t>(sockets_.size());
    sockets_.push_back(std::make_shared<UdpSocket>(io_, listen, settings_.interface));
    sockets_.back()->start(
        [this, index](const UdpSocket::Datagram& datagram) { on_datagram(index, datagram); });
    where += fmt::format("{}{}", where.empty() ? "" : ", ", listen);
  }
  tell_link(true, "UDP " + where);
}

void MqttsnAdapter::close() {
  for (const auto& socket : sockets_) socket->close();
  sockets_.clear();
}

void MqttsnAdapter::on_receipt(std::uint64_t receipt_id, ReceiptOutcome outcome) {
  input([&](SnGateway& gateway, TimePoint now) { gateway.on_receipt(receipt_id, outcome, now); });
}

void MqttsnAdapter::on_broker_message(const BrokerMessage& message, CommandId command) {
  input(
      [&](SnGateway& gateway, TimePoint now) { gateway.on_broker_message(message, command, now); });
}

void MqttsnAdapter::on_subscribe_result(const std::string& filter, bool granted) {
  input([&](SnGateway& gateway, TimePoint now) {
    gateway.on_subscribe_result(filter, granted, now);
  });
}

void MqttsnAdapter::on_broker_link(bool is_up) {
  input([&](SnGateway& gateway, TimePoint now) { gateway.on_broker_link(is_up, now); });
}

void MqttsnAdapter::reconfigure(TopicPolicy policy, RobotNames names) {
  input([&](SnGateway& gateway, TimePoint now) {
    gateway.reconfigure(std::move(policy), std::move(names), now);
  });
}

Counters MqttsnAdapter::counters() const {
  Counters counters = gateway_.counters();
  std::uint64_t dropped = 0;
  for (const auto& socket : sockets_) dropped += socket->kernel_drops();
  counters.push_back({"kernel_drops", dropped});
  counters.push_back({"truncated", truncated_});
  counters.push_back({"sends_failed", sends_failed_});
  return counters;
}

std::vector<std::uint16_t> MqttsnAdapter::bound_ports() const {
  std::vector<std::uint16_t> ports;
  for (const auto& socket : sockets_) ports.push_back(socket->port());
  return ports;
}

void MqttsnAdapter::on_datagram(std::uint8_t socket, const UdpSocket::Datagram& datagram) {
  if (datagram.is_truncated) ++truncated_;  // too long for the machine too, which counts it
  LocalAddress to{datagram.to, datagram.interface, socket};
  if (is_multicast(datagram.to)) {
    const auto source =
        choose_source(addresses_of_interface(datagram.interface), datagram.from.address);
    to.address = source.value_or(IpAddress{});
  }
  input([&](SnGateway& gateway, TimePoint now) {
    gateway.on_datagram(datagram.from, to, datagram.bytes, now);
  });
}

void MqttsnAdapter::perform(Action& action) {
  std::visit([this](auto& what) { perform(what); }, action);
}

void MqttsnAdapter::perform(SendDatagram& action) {
  if (sockets_.empty()) {
    ++sends_failed_;
    return;
  }
  const bool is_known = action.from.socket < sockets_.size();  // restored ones may be of old times
  UdpSocket& socket = *sockets_[is_known ? action.from.socket : 0];
  bool is_sent =
      is_known && socket.send(action.to, action.from.address, action.from.interface, action.bytes);
  if (!is_sent) is_sent = socket.send(action.to, IpAddress{}, 0, action.bytes);
  if (!is_sent) ++sends_failed_;
}

void MqttsnAdapter::perform(SendMulticast& action) {
  const auto group = asio::ip::make_address(*settings_.multicast_group);
  for (const auto& socket : sockets_) {
    if (!socket->can_reach(group)) continue;
    const Endpoint to = from_asio({group, socket->port()});
    for (const std::uint32_t interface : multicast_interfaces(settings_.interface))
      socket->send(to, IpAddress{}, interface, action.bytes);
  }
}

void MqttsnAdapter::perform(MeshEvent& event) {
  listener_.on_mesh_event(std::move(event));
  if (keeper_) keeper_->look();
}

void MqttsnAdapter::watch_interfaces() {
  if (!settings_.interface.empty()) follow_interface();
  if (settings_.multicast_group) join_groups();
  look_at_interfaces_in(watch_interval);
}

/// In place of the look that was planned.
void MqttsnAdapter::look_at_interfaces_in(Duration delay) {
  watch_timer_.expires_after(delay);
  watch_timer_.async_wait([this](boost::system::error_code error) {
    if (!error) watch_interfaces();
  });
}

/// A socket is bound to an interface by its index: one that was made anew needs new sockets.
void MqttsnAdapter::follow_interface() {
  const std::uint32_t index = interface_index(settings_.interface);
  if (index == interface_index_ && (index == 0 || !sockets_.empty())) return;
  interface_index_ = index;
  close();
  if (index == 0)
    return tell_link(false, "interface " + settings_.interface + " has gone" + interface_advice);
  try {
    open();
  } catch (const std::runtime_error& error) {
    close();
    tell_link(false, error.what());
  }
}

void MqttsnAdapter::join_groups() {
  const auto group = asio::ip::make_address(*settings_.multicast_group);
  for (const std::uint32_t interface : multicast_interfaces(settings_.interface)) {
    for (const auto& socket : sockets_) socket->join(group, interface);
  }
}

void MqttsnAdapter::tell_link(bool is_up, std::string detail) {
  listener_.on_mesh_event(LinkChange{Mesh::thread, is_up, std::move(detail)});
}

}  // namespace slamgw::mqttsn
