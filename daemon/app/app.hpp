// SPDX-License-Identifier: Apache-2.0
// The composition root: makes the parts, carries what one leaves to the next, and ends them in
// order. The only place that knows everybody; decides nothing itself.
#pragma once

#include <boost/asio/io_context.hpp>
#include <boost/asio/signal_set.hpp>
#include <boost/asio/steady_timer.hpp>
#include <functional>
#include <memory>
#include <string>

#include "daemon/app/pending_sends.hpp"
#include "daemon/config/config.hpp"
#include "daemon/control/control_server.hpp"
#include "daemon/core/adapter.hpp"
#include "daemon/core/gateway.hpp"
#include "daemon/delivery/outbox.hpp"
#include "daemon/mqtt/paho_upstream.hpp"
#include "daemon/mqtt/upstream_link.hpp"
#include "daemon/observability/link_log.hpp"
#include "daemon/observability/service_notifier.hpp"
#include "daemon/observability/traffic_log.hpp"
#include "daemon/runtime/descriptor_store.hpp"
#include "daemon/runtime/interface_watch.hpp"
#include "daemon/runtime/machine_driver.hpp"
#include "daemon/storage/sqlite_session_store.hpp"
#include "daemon/storage/sqlite_store.hpp"

namespace slamgw {

namespace ble {
class BleMeshAdapter;
}

/// `mqtt://host:port`, as in the configuration.
std::string broker_uri(const BrokerSettings& broker);

class App final : public MeshListener, public UpstreamListener, public ControlHandler {
 public:
  /// `config_file` is read again on SIGHUP.
  App(Config config, std::string config_file);
  ~App() override;

  /// Runs until SIGTERM or SIGINT. Throws std::runtime_error for what an operator must mend (a port
  /// in use).
  void run();

 private:
  void start_meshes();
  void start_control();
  void wait_for_signal();
  OrderAnswer reload() override;
  void reload_robots(const Config& wanted);
  void stop();
  void stop_when_flushed(TimePoint give_up_at);
  void publish_stats_regularly();
  void publish_stats();
  void log_overdue_lines(TimePoint now);

  /// The gateway is told when the store has become full or has room again.
  void on_outbox_drained();
  void perform(Upload& action);
  void perform(SubscribeAtBroker& action);
  void perform(UnsubscribeAtBroker& action);
  void perform(DeliverToMeshes& action);
  void perform(AnswerSubscribe& action);
  void perform(CommandOutcome& outcome);
  void perform(TrafficEvent& event);
  void perform(Notice& notice);
  void perform(PublishAtBroker& action);
  void perform(FireReceipt& action);
  void perform(WriteToStore& action);
  void perform(LoadFromStore& action);
  MeshAdapter* mesh(Mesh mesh) const { return meshes_[mesh].get(); }
  void tell_meshes_about_broker(bool is_up);

  void on_mesh_event(MeshEvent event) override;

  void on_link_up(bool session_present, const BrokerLimits& limits) override;
  void on_link_down(const std::string& why) override;
  void on_published(std::uint64_t sequence) override;
  void on_publish_refused(std::uint64_t sequence, const Refusal& refusal) override;
  void on_subscribe_result(const std::string& filter, bool granted) override;
  void on_message(BrokerMessage message, std::vector<std::uint32_t> subscriptions) override;

  ServiceState service_state() const;
  nlohmann::json status() override;
  nlohmann::json robots() override;
  void send(const std::string& robot, const std::string& type, Bytes payload,
            std::function<void(nlohmann::json)> done) override;
  void manage_ble(MeshOrder order, OrderDone done) override;
  void manage_store(StoreOrder order, OrderDone done) override;

  Config config_;
  const std::string config_file_;
  const TopicScheme scheme_;
  const Now started_;
  boost::asio::io_context io_{1};
  boost::asio::signal_set signals_;
  boost::asio::steady_timer stats_timer_;
  boost::asio::steady_timer stop_timer_;
  ServiceNotifier notifier_;
  DescriptorStore descriptors_;

  Gateway gateway_;
  MachineDriver<Gateway> gateway_driver_;
  Outbox outbox_;
  MachineDriver<Outbox> outbox_driver_;
  SqliteStore store_;
  SqliteSessionStore session_store_;
  PahoUpstream upstream_;
  std::shared_ptr<InterfaceWatch> network_watch_;
  LinkLog broker_log_;
  PerMesh<std::unique_ptr<MeshAdapter>> meshes_;  // nothing when not enabled
  ble::BleMeshAdapter* ble_ = nullptr;            // the one of `meshes_`, for operators' orders
  std::unique_ptr<ControlServer> control_;
  TrafficSampler sampler_;
  AwaitedLines awaited_lines_;
  PendingSends pending_sends_;
};

}  // namespace slamgw
