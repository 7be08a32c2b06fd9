// SPDX-License-Identifier: Apache-2.0
// The composition root: makes the parts, passes the actions of one to the next, and stops them in
// order. Decides nothing itself.
#pragma once

#include <boost/asio/io_context.hpp>
#include <boost/asio/signal_set.hpp>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "adapters/thread_border_router/io/border_router.hpp"
#include "daemon/app/fleet_member.hpp"
#include "daemon/app/meshes.hpp"
#include "daemon/app/reload.hpp"
#include "daemon/app/status_collector.hpp"
#include "daemon/config/config.hpp"
#include "daemon/control/control_server.hpp"
#include "daemon/core/adapter.hpp"
#include "daemon/core/gateway.hpp"
#include "daemon/core/join_requests.hpp"
#include "daemon/core/trace.hpp"
#include "daemon/delivery/outbox.hpp"
#include "daemon/mqtt/upstream.hpp"
#include "daemon/mqtt/upstream_listener.hpp"
#include "daemon/observability/link_log.hpp"
#include "daemon/observability/notice_lines.hpp"
#include "daemon/observability/service_notifier.hpp"
#include "daemon/observability/traffic_log.hpp"
#include "daemon/runtime/descriptor_store.hpp"
#include "daemon/runtime/interface_watch.hpp"
#include "daemon/runtime/machine_driver.hpp"
#include "daemon/runtime/timer.hpp"
#include "daemon/storage/disk_session_store.hpp"
#include "daemon/storage/disk_store.hpp"

namespace slamgw {

class App final : public MeshListener, public UpstreamListener, public ControlHandler {
 public:
  /// `config_file` is read again on SIGHUP.
  App(Config config, std::string config_file);
  ~App() override;

  /// Runs until SIGTERM or SIGINT. Throws std::runtime_error for what an operator must fix (a port
  /// in use).
  void run();

 private:
  void start_meshes();
  void start_border_router();
  void start_control();
  void wait_for_signal();
  OrderAnswer reload(const std::string& who);
  OrderAnswer read_configuration();
  OrderAnswer forget(const std::string& who, const std::string& robot);
  void report_configured_robots();
  /// Applies the settings that can change while the daemon runs.
  void apply(const Reload& reload);
  void stop();
  void stop_when_flushed(TimePoint give_up_at);
  void close_everything();
  void report_regularly();
  void publish_stats();
  void publish_now(std::string topic, Bytes payload);
  void warn_of_lost_messages();

  // Actions of the core (MessageStep: of the outbox, too):
  void perform(PassUp& action);
  void perform(TrafficEvent& event);
  void perform(MessageStep& step);
  void perform(Notice& notice);
  // Actions of JoinRequests:
  void perform(OrderJoining& action);
  void perform(AskJoining& action);
  void perform(PublishJoining& action);
  // Actions of the outbox:
  void perform(FireReceipt& action);
  /// Reports to the gateway that the store has become full or has room again.
  void on_outbox_drained();
  void submit(BrokerMessage message, const Receipt& receipt);

  void on_mesh_event(MeshEvent event) override;

  void on_link_up(const BrokerLimits& limits) override;
  void on_link_down(const std::string& why) override;
  void on_link_left(const std::string& why) override;
  void take_link_down(const std::string& why, const Now& now);
  void on_silence(bool is_silent) override;
  void report_broker_link();
  void on_published(std::uint64_t sequence) override;
  void on_publish_refused(std::uint64_t sequence, const Refusal& refusal) override;
  void on_subscribe_result(const std::string& filter, bool is_granted) override;
  void on_message(BrokerMessage message, const UserProperties& said) override;

  void on_request(const std::string& who, control::Request request, Answer answer) override;
  void on_watched(bool is_watched) override;
  nlohmann::json status();
  void send(const std::string& who, control::SendRequest command, const Answer& answer);
  void ping(const std::string& robot, OrderDone done);
  void manage_ble(const std::string& who, BleOrder order, OrderDone done);
  void manage_store(const std::string& who, StoreOrder order, OrderDone done);

  Config config_;
  const std::string config_file_;
  const TopicScheme scheme_;
  const Now started_;
  BrokerLink broker_link_{false, started_.wall, "no broker has answered since the start", {}};
  boost::asio::io_context io_{1};
  boost::asio::signal_set signals_;
  Timer stats_timer_;
  Timer stop_timer_;
  ServiceNotifier notifier_;
  DescriptorStore descriptors_;

  Gateway gateway_;
  MachineDriver<Gateway> gateway_driver_;
  Outbox outbox_;
  MachineDriver<Outbox> outbox_driver_;
  JoinRequests join_requests_;
  MachineDriver<JoinRequests> join_requests_driver_;
  DiskStore store_;
  DiskSessionStore session_store_;
  Upstream upstream_;
  Meshes meshes_;
  FleetMember fleet_;
  std::optional<border_router::BorderRouter> border_router_;
  std::shared_ptr<InterfaceWatch> network_watch_;

  LinkLog broker_log_;
  UnprovenLines unproven_lines_;
  TrafficLog traffic_log_;
  NoticeLines notice_lines_{unproven_lines_};
  Trace trace_;
  std::unique_ptr<ControlServer> control_;
  std::uint64_t inbound_dropped_ = 0;  // as the log last reported it
  StatusCollector status_;
};

}  // namespace slamgw
