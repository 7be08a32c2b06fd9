// SPDX-License-Identifier: Apache-2.0
// MqttsnAdapter with real sockets, a fake core, and clients.
#pragma once

#include <boost/asio/ip/udp.hpp>
#include <string>
#include <vector>

#include "adapters/mqttsn_udp/io/mqttsn_adapter.hpp"
#include "tests/mqttsn_udp/describe.hpp"
#include "tests/support/eventually.hpp"

namespace slamgw::mqttsn {

/// A core that grants every subscription and acknowledges every report at once.
class FakeCore final : public MeshListener {
 public:
  void on_mesh_event(MeshEvent event) override {
    if (auto* request = std::get_if<SubscribeRequest>(&event))
      adapter->on_subscribe_result(request->robot, request->filter, true);
    if (auto* request = std::get_if<NoteRequest>(&event))
      adapter->on_note(request->robot, ByteView());
    if (auto* report = std::get_if<Report>(&event)) {
      reports.push_back(*report);
      if (report->receipt.is_owed()) adapter->on_receipt(report->receipt.id, ReceiptOutcome::safe);
    }
    if (auto* link = std::get_if<LinkChange>(&event)) links.push_back(*link);
    if (auto* notice = std::get_if<Notice>(&event)) notices.push_back(*notice);
  }
  /// Returns the port of socket number `index` from the link's detail: "UDP 127.0.0.1:47193,
  /// [::1]:47193".
  std::uint16_t port(std::size_t index = 0) const {
    std::string_view where = links.back().detail;
    while (index-- > 0) where.remove_prefix(where.find(',') + 1);
    where = where.substr(0, where.find(','));
    return static_cast<std::uint16_t>(std::stoul(std::string(where.substr(where.rfind(':') + 1))));
  }
  MeshAdapter* adapter = nullptr;
  std::vector<Report> reports;
  std::vector<LinkChange> links;
  std::vector<Notice> notices;
};

class UdpRig {
 public:
  /// Makes an adapter without multicast.
  explicit UdpRig(std::vector<std::string> listen, Settings settings = {})
      : UdpRig(with(std::move(settings), std::move(listen)), AsIs{}) {}
  /// Makes an adapter with these settings. `sessions` may be null and outlives the rig.
  static UdpRig as_is(Settings settings, SessionStore* sessions = nullptr) {
    return UdpRig(std::move(settings), AsIs{}, sessions);
  }
  ~UdpRig() { adapter.stop(); }

  static Settings with(Settings settings, std::vector<std::string> listen) {
    settings.listen = std::move(listen);
    settings.multicast_group.reset();
    return settings;
  }

  boost::asio::io_context io;
  FakeCore core;
  MqttsnAdapter adapter;

 protected:
  struct AsIs {};
  UdpRig(Settings settings, AsIs, SessionStore* sessions = nullptr, RobotKeys keys = {})
      : adapter(io, std::move(settings), TopicPolicy(TopicScheme("ntnu-slam", "gw"), {}, {"ab"}),
                RobotNames(), core, sessions, nullptr, std::move(keys)) {
    core.adapter = &adapter;
    adapter.start();
    adapter.on_broker_link(true);
  }
};

/// Waits for a datagram. Returns "nothing" if none comes.
inline std::string receive(boost::asio::io_context& io, boost::asio::ip::udp::socket& socket,
                           boost::asio::ip::udp::endpoint* from = nullptr,
                           std::chrono::milliseconds limit = test::patience) {
  Bytes buffer(2000);
  boost::asio::ip::udp::endpoint sender;
  std::size_t size = 0;
  const auto has_come = [&] {
    boost::system::error_code error;
    size = socket.receive_from(boost::asio::buffer(buffer), sender, 0, error);
    return !error;
  };
  if (!test::eventually(io, has_come, limit)) return "nothing";
  if (from) *from = sender;
  return describe_octets(ByteView(buffer).first(size));
}

/// A client with a connected socket: the kernel drops answers from any other address (R17).
class UdpClient {
 public:
  UdpClient(UdpRig& rig, const std::string& address, std::size_t index = 0)
      : rig_(rig), socket_(rig.io) {
    socket_.connect({boost::asio::ip::make_address(address), rig.core.port(index)});
    socket_.non_blocking(true);
  }
  void send(const Packet& packet) { send_octets(encode(packet)); }
  void send_octets(const Bytes& octets) { socket_.send(boost::asio::buffer(octets)); }
  std::string receive() { return mqttsn::receive(rig_.io, socket_); }
  bool has_answer() { return socket_.available() > 0; }

 private:
  UdpRig& rig_;
  boost::asio::ip::udp::socket socket_;
};

}  // namespace slamgw::mqttsn
