// SPDX-License-Identifier: Apache-2.0
#include "daemon/app/app.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <csignal>
#include <filesystem>
#include <stdexcept>
#include <utility>

#include "adapters/ble_mesh_usb_cdc/io/ble_mesh_adapter.hpp"
#include "adapters/mqttsn_udp/io/mqttsn_adapter.hpp"
#include "daemon/config/load.hpp"
#include "daemon/observability/log.hpp"

namespace slamgw {
namespace {

constexpr std::chrono::seconds stats_interval{10};  // contract section 4
/// What an orderly end waits for the broker to take what is queued; well below systemd's patience.
constexpr std::chrono::seconds flush_patience{2};
constexpr std::chrono::milliseconds flush_poll{20};

/// Packages make it; without one (a demo, a developer) the daemon does, for itself alone.
void make_store_directory(const std::string& path) {
  namespace fs = std::filesystem;
  std::error_code error;
  if (fs::is_directory(path, error)) return;
  if (fs::create_directories(path, error)) fs::permissions(path, fs::perms::owner_all, error);
  if (!error) return;
  log_event(Severity::warning,
            fmt::format("store.directory {} can't be made: {}; nothing will survive a restart",
                        path, error.message()));
}

}  // namespace

std::string broker_uri(const BrokerSettings& broker) {
  const bool is_ipv6 = broker.host.find(':') != std::string::npos;
  const std::string host = is_ipv6 ? "[" + broker.host + "]" : broker.host;
  return fmt::format("{}://{}:{}", broker.tls ? "mqtts" : "mqtt", host, broker.port);
}

void App::on_outbox_drained() {
  const bool is_full = outbox_.backlog().is_full();
  if (gateway_.is_store_full() == is_full) return;
  gateway_driver_.input([&](Gateway& gateway, TimePoint) { gateway.on_store(is_full); });
}

App::App(Config config, std::string config_file)
    : config_(std::move(config)),
      config_file_(std::move(config_file)),
      scheme_(config_.topics.prefix, config_.gateway_id),
      started_(read_clocks()),
      signals_(io_, SIGTERM, SIGINT, SIGHUP),
      stats_timer_(io_),
      stop_timer_(io_),
      notifier_(io_, [this] { return service_state(); }),
      gateway_(scheme_, {SLAMGW_VERSION, config_.update_mode, started_.wall},
               [this](Mesh where, const std::string& robot) {
                 return mesh(where) ? mesh(where)->presence_of(robot) : std::nullopt;
               }),
      gateway_driver_(io_, gateway_,
                      [this](GatewayAction& action) {
                        std::visit([this](auto& what) { perform(what); }, action);
                      }),
      outbox_(config_.broker.max_inflight, config_.store.max_bytes),
      outbox_driver_(
          io_, outbox_,
          [this](OutboxAction& action) {
            std::visit([this](auto& what) { perform(what); }, action);
          },
          [this] { on_outbox_drained(); }),
      store_(io_, config_.store,
             [this](StoreEvent event) {
               outbox_driver_.input([&](Outbox& outbox, TimePoint now) {
                 outbox.on_store_event(std::move(event), now);
               });
             }),
      session_store_(io_, config_.store.directory, [this](Notice notice) { perform(notice); }),
      upstream_(io_, config_.broker, {scheme_.state_topic(), R"({"state":"offline"})"}, *this),
      network_watch_(std::make_shared<InterfaceWatch>(io_)),
      broker_log_(broker_uri(config_.broker)),
      sampler_(config_.log.traffic) {}

App::~App() = default;

void App::run() {
  log_event(Severity::notice, fmt::format("slam-gatewayd {} starts as gateway '{}'", SLAMGW_VERSION,
                                          config_.gateway_id));
  make_store_directory(config_.store.directory);
  store_.start();
  wait_for_signal();
  start_control();
  start_meshes();
  upstream_.read_credentials_with([this] { return load_credentials(config_.broker); });
  upstream_.start();
  network_watch_->start([this] { upstream_.retry_now(); });
  publish_stats_regularly();
  notifier_.ready();
  io_.run();
  log_event(Severity::notice, "slam-gatewayd has ended in order");
}

void App::start_meshes() {
  const RobotNames names(config_.robots);
  if (config_.mqttsn.enabled) {
    TopicPolicy policy(scheme_, config_.topics.extra_publish, config_.topics.extra_subscribe);
    meshes_[Mesh::thread] = std::make_unique<mqttsn::MqttsnAdapter>(
        io_, config_.mqttsn, std::move(policy), names, *this, &session_store_, &descriptors_);
  }
  if (config_.ble_mesh.enabled) {
    auto adapter = std::make_unique<ble::BleMeshAdapter>(io_, config_.ble_mesh, scheme_, names,
                                                         config_.store.directory, *this);
    ble_ = adapter.get();
    meshes_[Mesh::ble] = std::move(adapter);
  }
  if (std::ranges::none_of(meshes_, [](const auto& adapter) { return adapter != nullptr; })) {
    log_event(Severity::warning,
              "no mesh is enabled: set mqttsn.enabled or ble_mesh.enabled to true");
  }
  for (auto& adapter : meshes_) {
    if (adapter) adapter->start();
  }
  descriptors_.drop_rest();
}

void App::start_control() {
  control_ = std::make_unique<ControlServer>(io_, config_.control_socket, *this);
  try {
    control_->start();
  } catch (const std::runtime_error& error) {  // robots come before operators
    log_event(Severity::warning,
              fmt::format("control.socket: {}; slam-gatewayctl will not work", error.what()));
    control_.reset();
  }
}

void App::wait_for_signal() {
  signals_.async_wait([this](boost::system::error_code error, int signal) {
    if (error) return;
    if (signal != SIGHUP) return stop();
    notifier_.reloading();
    reload();
    notifier_.ready();
    wait_for_signal();
  });
}

void App::stop() {
  notifier_.stopping();
  log_event(Severity::notice, "slam-gatewayd ends");
  stats_timer_.cancel();
  control_.reset();
  for (auto& adapter : meshes_) {
    if (adapter) adapter->stop_listening();
  }
  gateway_driver_.input([](Gateway& gateway, const Now&) { gateway.on_stop(); });
  outbox_driver_.input([](Outbox& outbox, TimePoint now) { outbox.on_stop(now); });
  stop_when_flushed(read_clocks().mono + flush_patience);
}

void App::stop_when_flushed(TimePoint give_up_at) {
  if (outbox_.is_settled() || read_clocks().mono >= give_up_at) {
    if (outbox_.unsaved() > 0) {
      log_event(Severity::warning,
                fmt::format("{} messages are neither with the broker nor in the store",
                            outbox_.unsaved()));
    }
    log_overdue_lines(TimePoint::max());
    for (auto& adapter : meshes_) {
      if (adapter) adapter->stop();
    }
    gateway_driver_.stop();
    outbox_driver_.stop();
    network_watch_->stop();
    upstream_.stop();
    store_.stop();
    session_store_.stop();
    io_.stop();
    return;
  }
  stop_timer_.expires_after(flush_poll);
  stop_timer_.async_wait([this, give_up_at](boost::system::error_code error) {
    if (!error) stop_when_flushed(give_up_at);
  });
}

void App::publish_stats_regularly() {
  stats_timer_.expires_after(stats_interval);
  stats_timer_.async_wait([this](boost::system::error_code error) {
    if (error) return;
    pending_sends_.on_time(read_clocks().mono);
    publish_stats();
    log_overdue_lines(read_clocks().mono);
    flush_log();
    publish_stats_regularly();
  });
}

void App::publish_stats() {
  if (!broker_log_.is_up()) return;  // of no use later
  Upload upload{{scheme_.stats_topic(), to_bytes(status().dump()), Qos::at_most_once, false}, {}};
  perform(upload);
}

void App::perform(Upload& action) {
  outbox_driver_.input([&](Outbox& outbox, TimePoint now) {
    outbox.submit(std::move(action.message), action.receipt, now);
  });
}

void App::perform(SubscribeAtBroker& action) {
  upstream_.subscribe(action.filter, action.qos, action.id);
}

void App::perform(UnsubscribeAtBroker& action) { upstream_.unsubscribe(action.filter); }

void App::perform(DeliverToMeshes& action) {
  for (const Mesh each : all_meshes)
    if (mesh(each)) mesh(each)->on_broker_message(action.message, action.command_on(each));
}

void App::perform(AnswerSubscribe& action) {
  if (mesh(action.mesh)) mesh(action.mesh)->on_subscribe_result(action.filter, action.granted);
}

void App::perform(CommandOutcome& outcome) { pending_sends_.on_outcome(outcome); }

void App::perform(TrafficEvent& event) {
  if (control_ && control_->has_watchers()) control_->publish_traffic(event);
  if (!is_logged(Severity::info)) return;
  const auto line = sampler_.on_traffic(event, event.at);
  if (!line) return;
  const auto entry = awaited_lines_.add(event, {traffic_text(event, *line), traffic_fields(event)});
  if (entry) log_event(Severity::info, entry->text, entry->fields);
}

void App::log_overdue_lines(TimePoint now) {
  for (const TrafficEntry& entry : awaited_lines_.take_overdue(now))
    log_event(Severity::info, entry.text, entry.fields);
}

void App::perform(Notice& notice) { log_notice(notice); }

void App::perform(PublishAtBroker& action) {
  upstream_.publish(action.sequence, std::move(action.message));
}

void App::perform(FireReceipt& action) {
  if (awaited_lines_.has(action.receipt)) {
    const auto entry =
        awaited_lines_.on_receipt(action.receipt, action.outcome, read_clocks().mono);
    log_event(Severity::info, entry.text, entry.fields);
  }
  if (mesh(action.receipt.mesh)) {
    mesh(action.receipt.mesh)->on_receipt(action.receipt.id, action.outcome);
  }
}

void App::perform(WriteToStore& action) { store_.ask(std::move(action)); }

void App::perform(LoadFromStore& action) { store_.ask(action); }

void App::send(const std::string& robot, const std::string& type, Bytes payload,
               std::function<void(nlohmann::json)> done) {
  if (!is_valid_level(robot) || !is_valid_level(type)) {
    return done(outcome_json("refused", 0, "robot and type are one topic level each"));
  }
  if (pending_sends_.is_full())
    return done(outcome_json("refused", 0, "too many commands wait for their outcome"));
  gateway_driver_.input([&](Gateway& gateway, const Now& now) {
    const CommandId command = gateway.on_operator_command(robot, type, std::move(payload), now);
    pending_sends_.add(command, done, now.mono);  // before its outcome is performed
  });
}

void App::manage_store(StoreOrder order, OrderDone done) {
  store_.perform(std::move(order), std::move(done));
}

void App::manage_ble(MeshOrder order, OrderDone done) {
  if (!ble_) return done({{}, "the BLE mesh is not enabled: set ble_mesh.enabled to true"});
  ble_->manage(std::move(order), std::move(done));
}

void App::on_mesh_event(MeshEvent event) {
  gateway_driver_.input(
      [&](Gateway& gateway, const Now& now) { gateway.on_mesh_event(std::move(event), now); });
}

void App::tell_meshes_about_broker(bool is_up) {
  gateway_driver_.input(
      [&](Gateway& gateway, const Now& now) { gateway.on_broker_link(is_up, now); });
  for (auto& adapter : meshes_) {
    if (adapter) adapter->on_broker_link(is_up);
  }
}

void App::on_link_up(bool, const BrokerLimits& limits) {
  std::string detail = upstream_.version() == MqttVersion::v5 ? "MQTT 5" : "MQTT 3.1.1";
  if (const std::string words = to_words(limits); !words.empty()) detail += "; it takes " + words;
  log_notice(broker_log_.on_up(detail, read_clocks()));
  // The outbox first: else what the gateway says about itself would go to the disk on its way.
  outbox_driver_.input(
      [&](Outbox& outbox, TimePoint now) { outbox.on_link_up(limits.receive_maximum, now); });
  tell_meshes_about_broker(true);
}

void App::on_link_down(const std::string& why) {
  const bool was_up = broker_log_.is_up();
  if (const auto notice = broker_log_.on_down(why, read_clocks())) log_notice(*notice);
  if (!was_up) return;
  outbox_driver_.input([](Outbox& outbox, TimePoint now) { outbox.on_link_down(now); });
  tell_meshes_about_broker(false);
}

void App::on_published(std::uint64_t sequence) {
  outbox_driver_.input([&](Outbox& outbox, TimePoint now) { outbox.on_published(sequence, now); });
}

void App::on_publish_refused(std::uint64_t sequence, const Refusal& refusal) {
  outbox_driver_.input(
      [&](Outbox& outbox, TimePoint now) { outbox.on_publish_refused(sequence, refusal, now); });
}

void App::on_subscribe_result(const std::string& filter, bool granted) {
  gateway_driver_.input(
      [&](Gateway& gateway, const Now&) { gateway.on_subscribe_result(filter, granted); });
}

void App::on_message(BrokerMessage message, std::vector<std::uint32_t> subscriptions) {
  gateway_driver_.input([&](Gateway& gateway, const Now& now) {
    gateway.on_broker_message(std::move(message), subscriptions, now);
  });
}

}  // namespace slamgw
