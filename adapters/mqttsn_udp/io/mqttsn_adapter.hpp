// SPDX-License-Identifier: Apache-2.0
// The I/O shell of MQTT-SN: UDP sockets, multicast and one timer around SnGateway. Decides nothing
// about the protocol.
#pragma once

#include <boost/asio/io_context.hpp>
#include <map>
#include <memory>
#include <nlohmann/json_fwd.hpp>
#include <optional>
#include <string>
#include <vector>

#include "adapters/mqttsn_udp/io/dtls_port.hpp"
#include "adapters/mqttsn_udp/io/lan_announcement.hpp"
#include "adapters/mqttsn_udp/io/network_interfaces.hpp"
#include "adapters/mqttsn_udp/io/session_keeper.hpp"
#include "adapters/mqttsn_udp/io/udp_socket.hpp"
#include "adapters/mqttsn_udp/sn_gateway.hpp"
#include "daemon/core/adapter.hpp"
#include "daemon/core/log_throttle.hpp"
#include "daemon/runtime/descriptor_store.hpp"
#include "daemon/runtime/interface_watch.hpp"
#include "daemon/runtime/mesh_shell.hpp"
#include "daemon/runtime/timer.hpp"

namespace slamgw::mqttsn {

class MqttsnAdapter final : public MeshShell<SnGateway> {
 public:
  /// `sessions` and `descriptors` may be null: no session, or socket, outlives the daemon then.
  /// Both and `listener` must outlive the adapter.
  MqttsnAdapter(boost::asio::io_context& io, Settings settings, TopicPolicy policy,
                RobotNames names, MeshListener& listener, SessionStore* sessions = nullptr,
                DescriptorStore* descriptors = nullptr, RobotKeys keys = {});

  void start() override;
  void stop_listening() override;
  void stop() override;
  void on_session_held(const std::string& robot) override;
  std::vector<WaitingMessage> give_up(const std::string& robot) override;
  void forget(const std::string& robot) override;
  void on_note(const std::string& robot, std::optional<ByteView> note) override;
  Counters counters() const override;
  std::optional<MeshPlaces> places() const override { return driver().machine().places(); }

  /// Call before start(). Clients may not use the names of other meshes' robots.
  void refuse_names(NameCheck is_elsewhere) { gateway_.refuse_names(std::move(is_elsewhere)); }
  /// See SnGateway.
  void ask_where_served(Roaming::ServedElsewhere ask) { gateway_.ask_where_served(std::move(ask)); }

  /// See SnGateway. `done` is called once.
  void ping(const std::string& robot, OrderDone done);
  /// See SnGateway.
  nlohmann::json report(const std::optional<std::string>& robot) const;

  /// Applies `topics.*`, `robots` and their keys, which were read again.
  void reconfigure(TopicPolicy policy, RobotNames names, RobotKeys keys);

 private:
  MachineDriver<SnGateway>& driver() override { return driver_; }
  const MachineDriver<SnGateway>& driver() const override { return driver_; }
  void on_datagram(const UdpSocket::Datagram& datagram);
  void drop_unserved(const UdpSocket::Datagram& datagram);
  void on_decrypted(const UdpSocket::Datagram& datagram, const std::string& identity);
  void perform(SendDatagram& action);
  void perform(SendMulticast& action);
  void perform(PingEnded& ended);
  void perform(MeshEvent& event);
  void open();
  void close();
  std::vector<int> take_kept(const std::vector<std::string>& listen);
  std::shared_ptr<UdpSocket> open_socket(const std::string& listen, int kept, const char* key);
  std::vector<std::shared_ptr<UdpSocket>> all_sockets() const;
  std::string kept_name(const std::string& listen) const;
  /// Follows interfaces that come and go, also that of `mqttsn.interface` (R19).
  void watch_interfaces();
  void check_interfaces_in(Duration delay);
  void follow_interface();
  void serve_multicast();
  void advertise_on(const NetworkInterface& interface, ByteView bytes);
  std::optional<IpAddress> lasting_address(const NetworkInterface& interface) const;
  const NetworkInterface* find_interface(std::uint32_t index) const;
  bool is_served(std::uint32_t interface) const;
  bool takes_multicast(const NetworkInterface& interface) const;
  std::string bound_to() const;
  std::string thread_interfaces() const;
  std::uint32_t index_of_interface() const;
  void report_open();
  void announce_on_lan();
  void report_link(bool is_up, std::string detail);

  const Settings settings_;
  MeshListener& listener_;
  DescriptorStore* const descriptors_;
  const std::string announced_name_;  // on the LAN
  boost::asio::io_context& io_;
  SnGateway gateway_;
  MachineDriver<SnGateway> driver_;
  std::optional<SessionKeeper> keeper_;
  std::vector<std::shared_ptr<UdpSocket>> sockets_;  // none while the interface is away
  std::unique_ptr<DtlsPort> dtls_;                   // null without keys_file
  std::optional<LanAnnouncement> announcement_;      // none without `mqttsn.announce`
  std::string where_;                                // the addresses that the sockets listen on
  std::uint32_t interface_index_ = 0;                // of `mqttsn.interface`; 0: it is away
  std::string only_thread_;  // names of the interfaces served beside loopback; empty: all are
  std::vector<NetworkInterface> interfaces_;            // as of the last check
  std::map<std::uint32_t, IpAddress> advertised_from_;  // last success, by interface
  std::shared_ptr<InterfaceWatch> interface_watch_;
  Timer watch_timer_;
  std::map<std::uint64_t, OrderDone> pings_;  // by their ids
  std::uint64_t last_ping_ = 0;
  UdpSocket::Counts counts_;  ///< of sockets that were closed, and what found no socket
  std::uint64_t unserved_ = 0;
  LogThrottle unserved_lines_{std::chrono::minutes{1}};
};

}  // namespace slamgw::mqttsn
