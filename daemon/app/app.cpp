// SPDX-License-Identifier: Apache-2.0
#include "daemon/app/app.hpp"

#include <boost/asio/io_context.hpp>
#include <boost/asio/signal_set.hpp>
#include <nlohmann/json.hpp>

#include <fmt/format.h>

#include <csignal>
#include <filesystem>
#include <functional>
#include <memory>
#include <optional>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include "adapters/thread_border_router/io/border_router.hpp"
#include "daemon/app/fleet_member.hpp"
#include "daemon/app/meshes.hpp"
#include "daemon/app/numbers_text.hpp"
#include "daemon/app/reload.hpp"
#include "daemon/app/status_collector.hpp"
#include "daemon/config/config.hpp"
#include "daemon/config/io/load.hpp"
#include "daemon/control/control_server.hpp"
#include "daemon/core/adapter.hpp"
#include "daemon/core/gateway.hpp"
#include "daemon/core/join_requests.hpp"
#include "daemon/core/result.hpp"
#include "daemon/core/trace.hpp"
#include "daemon/core/utf8.hpp"
#include "daemon/delivery/outbox.hpp"
#include "daemon/mqtt/configured_link.hpp"
#include "daemon/mqtt/upstream.hpp"
#include "daemon/mqtt/upstream_listener.hpp"
#include "daemon/observability/audit_notice.hpp"
#include "daemon/observability/link_log.hpp"
#include "daemon/observability/log.hpp"
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
namespace {

constexpr std::chrono::seconds stats_interval{10};  // docs/topics.md
/// Time given to the broker, and to a robot that joins, at shutdown; well below systemd's patience.
constexpr std::chrono::seconds flush_patience{2};
constexpr std::chrono::milliseconds flush_poll{20};

/// Makes the store's directory where no package has made it (a demo, a developer's computer). Only
/// the daemon may use it.
void prepare_store_directory(const std::string& path) {
  namespace fs = std::filesystem;
  std::error_code error;
  if (fs::is_directory(path, error)) return;
  if (fs::create_directories(path, error)) fs::permissions(path, fs::perms::owner_all, error);
  if (!error) return;
  log_event(Severity::warning,
            fmt::format("store.directory {} can't be made: {}; nothing will survive a restart",
                        path, error.message()));
}

Gateway::Settings gateway_settings(const Config& config, const Now& started) {
  Gateway::Settings settings{SLAMGW_VERSION, config.update_mode, started.wall};
  settings.retain = config.topics.retain;
  settings.describes_robots = config.topics.home_assistant;
  return settings;
}

/// Returns a `done` that writes to the audit trail before it answers, even when the client has
/// gone.
OrderDone record(const std::string& who, const std::optional<AuditedOrder>& order, OrderDone done) {
  if (!order) return done;
  return [who, order = *order, done = std::move(done)](OrderAnswer answer) {
    log_notice(audit_notice(who, order, answer));
    done(std::move(answer));
  };
}

/// Without signal sets, another SIGTERM would end the process with a status of its own.
void block_signals() {
  sigset_t all;
  sigfillset(&all);
  pthread_sigmask(SIG_BLOCK, &all, nullptr);
}

std::set<std::string> ids_of(const std::vector<RobotName>& robots) {
  std::set<std::string> ids;
  for (const RobotName& robot : robots) ids.insert(robot.id);
  return ids;
}

}  // namespace

/// Makes the parts, passes the actions of one to the next, and stops them in order. Decides nothing
/// itself.
class App final : public MeshListener, public UpstreamListener, public ControlHandler {
 public:
  App(Config config, std::string config_file);

  void run();

 private:
  void start_meshes();
  void start_border_router();
  void start_control();
  void wait_for_stop();
  void wait_for_reload();
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
  bool note_link_down(const std::string& why, const Now& now);
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
  /// Two sets: one set reports all signals of the lower number, SIGHUP, before a SIGTERM.
  boost::asio::signal_set stop_signals_;
  boost::asio::signal_set reload_signals_;
  bool is_stopping_ = false;
  Timer stats_timer_;
  Timer stop_timer_;
  LogRetry log_retry_;
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

App::App(Config config, std::string config_file)
    : config_(std::move(config)),
      config_file_(std::move(config_file)),
      scheme_(config_.topics.prefix, config_.gateway_id),
      started_(read_clocks()),
      stop_signals_(io_, SIGTERM, SIGINT),
      reload_signals_(io_, SIGHUP),
      stats_timer_(io_),
      stop_timer_(io_),
      log_retry_(io_),
      notifier_(io_, [this] { return status_.service_state(); }),
      gateway_(
          scheme_, gateway_settings(config_, started_), broker_link_,
          [this](Mesh mesh, const std::string& robot) { return meshes_.presence_of(mesh, robot); }),
      gateway_driver_(
          io_, gateway_,
          [this](GatewayAction& action) {
            std::visit(
                overloaded{
                    [this](Upload& up) { submit(std::move(up.message), up.receipt); },
                    [this](RobotForgotten& forgotten) { fleet_.perform(forgotten); },
                    [this](WantSession& want) { fleet_.perform(want); },
                    [this](SubscribeAtBroker& what) { upstream_.subscribe(what.filter); },
                    [this](UnsubscribeAtBroker& what) { upstream_.unsubscribe(what.filter); },
                    [this](DeliverToMesh& down) { meshes_.deliver(down); },
                    [](AnswerAsker& answer) { answer.asker->done(answer.outcome); },
                    [this](CommandOutcome& it) { trace_.on_outcome(it, read_clocks()); },
                    [this](auto& what) { perform(what); },
                },
                action);
          }),
      outbox_(config_.broker.max_inflight, config_.store.max_bytes),
      outbox_driver_(
          io_, outbox_,
          [this](OutboxAction& action) {
            std::visit(overloaded{
                           [this](PublishAtBroker& publish) {
                             const auto* message = outbox_.under_way(publish.sequence);
                             if (message)
                               upstream_.publish(publish.sequence, *message, publish.is_trial);
                           },
                           [this](WriteToStore& write) { store_.ask(std::move(write)); },
                           [this](LoadFromStore& load) { store_.ask(load); },
                           [this](RetryDeadLetters& retry) { store_.ask(std::move(retry)); },
                           [this](auto& what) { perform(what); },
                       },
                       action);
          },
          [this] { on_outbox_drained(); }),
      join_requests_driver_(io_, join_requests_,
                            [this](JoinAction& action) {
                              std::visit([this](auto& what) { perform(what); }, action);
                            }),
      store_(io_, config_.store,
             [this](StoreEvent event) {
               outbox_driver_->on_store_event(std::move(event), read_clocks());
             }),
      session_store_(io_, config_.store.directory, DiskSessionStore::mqttsn_sessions(),
                     [this](Notice notice) { perform(notice); }),
      upstream_(io_, config_.broker,
                {make_configured_link, {scheme_.state_topic(), R"({"state":"offline"})"}}, *this),
      meshes_(io_, config_, scheme_, session_store_, descriptors_, *this),
      fleet_(io_, config_, scheme_, gateway_, gateway_driver_, meshes_, upstream_,
             [this](BrokerMessage message) { submit(std::move(message), no_receipt); }),
      network_watch_(std::make_shared<InterfaceWatch>(io_)),
      broker_log_(broker_uri(config_.broker)),
      traffic_log_(config_.log.traffic, unproven_lines_),
      trace_(
          scheme_,
          [this](const std::string& robot, Mesh mesh) {
            return gateway_.registry().address_of(robot, mesh);
          },
          [this](const TraceEvent& event) {
            if (control_) control_->publish(event);
          }),
      status_{config_, broker_link_, gateway_, outbox_, meshes_, upstream_, fleet_, started_.mono} {
}

void App::run() {
  log_event(Severity::notice, fmt::format("slam-gatewayd {} starts as gateway '{}'", SLAMGW_VERSION,
                                          config_.gateway_id));
  prepare_store_directory(config_.store.directory);
  store_.start();
  wait_for_stop();
  wait_for_reload();
  start_control();
  report_configured_robots();
  start_meshes();
  if (config_.ble_mesh.provisioning.over_mqtt)
    gateway_driver_->subscribe_own(scheme_.join_request_topic());
  start_border_router();
  fleet_.start();
  upstream_.read_credentials_with([this] { return load_credentials(config_.broker); });
  upstream_.start();
  network_watch_->start([this] { upstream_.retry_now(); });
  stats_timer_.every(stats_interval, [this] { report_regularly(); });
  notifier_.ready();
  io_.run();
  block_signals();
  log_event(Severity::notice, "slam-gatewayd has shut down cleanly");
}

void App::start_meshes() {
  if (!meshes_.has_any()) {
    log_event(Severity::warning,
              "no mesh is enabled: set mqttsn.enabled or ble_mesh.enabled to true");
  }
  meshes_.each(&MeshAdapter::start);
  for (const std::string& filter : meshes_.relay_filters()) gateway_driver_->subscribe_own(filter);
  descriptors_.drop_rest();
}

void App::start_border_router() {
  if (!config_.mqttsn.enabled) return;
  const auto publish = [this](const std::string& json) {
    submit({scheme_.thread_topic(), to_bytes(json), Qos::at_least_once, true}, no_receipt);
  };
  border_router_.emplace(io_, publish, [this](Notice& notice) { perform(notice); });
  border_router_->start();
}

void App::start_control() {
  control_ = std::make_unique<ControlServer>(io_, config_.control_socket, *this);
  try {
    control_->start();
  } catch (const std::runtime_error& error) {  // robots matter more than operators
    log_event(Severity::warning,
              fmt::format("control.socket: {}; slam-gatewayctl will not work", error.what()));
    control_.reset();
  }
}

void App::wait_for_stop() {
  stop_signals_.async_wait([this](boost::system::error_code error, int) {
    if (!error) stop();
  });
}

void App::wait_for_reload() {
  reload_signals_.async_wait([this](boost::system::error_code error, int) {
    if (error || is_stopping_) return;
    reload("SIGHUP");
    wait_for_reload();
  });
}

OrderAnswer App::reload(const std::string& who) {
  notifier_.reloading();
  OrderAnswer answer = read_configuration();
  log_notice(audit_notice(who, {"reload", {}}, answer));
  notifier_.ready();
  return answer;
}

OrderAnswer App::read_configuration() {
  ParseResult result = load_config(config_file_);
  if (!result.problems.empty()) {
    const std::string refusal = "the configuration was not changed: fix the file, then reload";
    std::string error;
    for (const Problem& problem : result.problems) {
      log_event(Severity::error, to_string(problem));
      error += to_string(problem) + "\n";
    }
    log_event(Severity::error, refusal);
    return {{}, error + refusal};
  }
  for (const Problem& notice : result.notices) log_event(Severity::notice, to_string(notice));
  for (const Problem& warning : result.warnings) log_event(Severity::warning, to_string(warning));
  Reload reload = reload_of(config_, std::move(result.config));
  if (!config_.broker.credentials_file && is_credential_outdated())
    reload.needs_restart += fmt::format(
        "{}the broker's user and password, which systemd copies for the service at its start",
        reload.needs_restart.empty() ? "" : ", ");
  apply(reload);
  log_event(Severity::notice,
            "configuration read again: " +
                (reload.in_force.empty() ? "no changes applied" : "applied: " + reload.in_force));
  if (!reload.needs_restart.empty())
    log_event(Severity::warning, "only a restart changes: " + reload.needs_restart);
  return {answer_json(reload).dump(), {}};
}

void App::report_configured_robots() {
  gateway_.set_names(RobotNames(config_.robots, Bans(config_.bans)));
  gateway_driver_->on_configured(ids_of(config_.robots));
}

void App::apply(const Reload& reload) {
  config_ = reload.config;
  configure_log(config_.log.level);
  traffic_log_.reconfigure(config_.log.traffic);
  meshes_.reconfigure(config_);
  gateway_driver_->presence().describe_robots(config_.topics.home_assistant, read_clocks());
  report_configured_robots();
  for (const std::string& name : reload.replaced_names) gateway_driver_->forget(name);
  upstream_.reconfigure(config_.broker);
  broker_log_.rename(broker_uri(config_.broker));
}

void App::stop() {
  is_stopping_ = true;
  notifier_.stopping();
  log_event(Severity::notice, "slam-gatewayd is shutting down");
  stats_timer_.cancel();
  if (border_router_) border_router_->stop();
  on_watched(false);
  control_.reset();
  meshes_.each(&MeshAdapter::stop_listening);
  gateway_driver_->on_stop(read_clocks());
  outbox_driver_->on_stop(read_clocks());
  stop_when_flushed(read_clocks().mono + flush_patience);
}

void App::stop_when_flushed(TimePoint give_up_at) {
  const bool are_closed = fleet_.stop_taking();
  const bool is_flushed = are_closed && outbox_.is_settled() && meshes_.are_settled();
  if (is_flushed || read_clocks().mono >= give_up_at) return close_everything();
  stop_timer_.after(flush_poll, [this, give_up_at] { stop_when_flushed(give_up_at); });
}

void App::close_everything() {
  if (outbox_.unsaved() > 0) {
    log_event(Severity::warning,
              fmt::format("{} messages were neither delivered nor stored", outbox_.unsaved()));
  }
  traffic_log_.write_overdue(TimePoint::max());
  meshes_.each(&MeshAdapter::stop);
  fleet_.stop();
  gateway_driver_.stop();
  outbox_driver_.stop();
  join_requests_driver_.stop();
  network_watch_->stop();
  upstream_.stop();
  store_.stop();
  session_store_.stop();
  io_.stop();
}

void App::report_regularly() {
  warn_of_lost_messages();
  publish_stats();
  traffic_log_.write_overdue(read_clocks().mono);
  for (const Notice& summary : notice_lines_.summaries()) log_notice(summary);
  flush_log();
}

/// Warns once for each burst, because this is called every stats_interval.
void App::warn_of_lost_messages() {
  const std::uint64_t dropped = upstream_.inbound_dropped();
  const std::uint64_t news = dropped - std::exchange(inbound_dropped_, dropped);
  if (news == 0) return;
  log_event(Severity::warning,
            fmt::format("lost {} messages from the broker: they came faster than this host can "
                        "process them; see topics.extra_subscribe and what servers publish",
                        news));
}

void App::publish_stats() {
  publish_now(scheme_.stats_topic(),
              to_bytes(escape_unprintable(
                  status().dump(-1, ' ', false, nlohmann::json::error_handler_t::replace))));
  publish_now(scheme_.numbers_topic(),
              numbers_text(gateway_.registry().robots(), read_clocks().mono));
}

/// Drops the message while the broker is offline: later it would be out of date.
void App::publish_now(std::string topic, Bytes payload) {
  if (!broker_link_.is_up) return;
  submit({std::move(topic), std::move(payload), Qos::at_most_once, false}, no_receipt);
}

void App::perform(PassUp& action) {
  perform(action.event);
  Upload upload = action.upload();
  submit(std::move(upload.message), upload.receipt);
}

void App::submit(BrokerMessage message, const Receipt& receipt) {
  outbox_driver_->submit(std::move(message), receipt, read_clocks());
}

void App::perform(TrafficEvent& event) {
  traffic_log_.on_traffic(event);
  trace_.on_traffic(event);
}

void App::perform(MessageStep& step) { trace_.on_step(step, read_clocks()); }

void App::perform(Notice& notice) {
  if (notice_lines_.may_write(notice, read_clocks().mono)) log_notice(notice);
}

void App::perform(OrderJoining& action) {
  manage_ble(action.who, action.order, [this](const OrderAnswer& answer) {
    if (!answer.error.empty()) join_requests_driver_->on_ordered(answer, read_clocks());
  });
}

void App::perform(AskJoining& action) {
  meshes_.manage_ble(action.order, [this](const OrderAnswer& answer) {
    join_requests_driver_->on_news(answer, read_clocks());
  });
}

void App::perform(PublishJoining& action) {
  publish_now(scheme_.join_response_topic(), to_bytes(action.document));
}

void App::perform(FireReceipt& action) {
  traffic_log_.on_receipt(action.receipt, action.outcome, read_clocks().mono);
  gateway_driver_->on_receipt(action.receipt, action.outcome, read_clocks());
  meshes_.fire(action.receipt, action.outcome);
}

void App::on_outbox_drained() {
  const bool is_full = outbox_.backlog().is_full();
  if (gateway_.presence().is_store_full() == is_full) return;
  gateway_driver_->presence().on_store(is_full);
}

// --- Operators -----------------------------------------------------------------------------------

void App::on_request(const std::string& who, control::Request request, Answer answer) {
  using namespace control;
  const OrderDone done = [answer](const OrderAnswer& ended) { answer(order_line(ended)); };
  std::visit(overloaded{
                 [&](StatusRequest&) { answer(result_line(status())); },
                 [&](RobotsRequest& asked) {
                   answer(result_line(status_.robots(asked.robot, read_clocks().mono)));
                 },
                 [&](FleetRequest&) { answer(result_line(fleet_.status())); },
                 [&](MqttsnClientsRequest& asked) { done(meshes_.mqttsn_clients(asked.robot)); },
                 [&](ReloadRequest&) { done(reload(who)); },
                 [&](ForgetRequest& order) { done(forget(who, order.robot)); },
                 [&](SendRequest& command) { send(who, std::move(command), answer); },
                 [&](PingRequest& asked) { ping(asked.robot, done); },
                 [&](BleOrder& order) { manage_ble(who, std::move(order), done); },
                 [&](StoreOrder& order) { manage_store(who, std::move(order), done); },
                 [](WatchRequest&) {},
             },
             request);
}

nlohmann::json App::status() {
  PerMesh<MeshLink> links = status_.mesh_links();
  if (config_.ble_mesh.provisioning.over_mqtt) join_requests_.add_to(links[Mesh::ble].counters);
  if (border_router_) links[Mesh::thread].role = border_router_->role();
  nlohmann::json status =
      status_.status(links, control_ ? control_->counters() : Counters{}, read_clocks().mono);
  status["configuration"] = std::filesystem::absolute(config_file_).lexically_normal().string();
  return status;
}

void App::on_watched(bool is_watched) {
  trace_.turn(is_watched);
  meshes_.each(&MeshAdapter::trace, is_watched);
  outbox_driver_->on_trace(is_watched);
}

void App::send(const std::string& who, control::SendRequest command, const Answer& answer) {
  const auto done = [answer](const CommandOutcome& outcome) {
    answer(control::result_line({{"outcome", to_string(outcome.result)},
                                 {"after_ms", outcome.after.count()},
                                 {"why", outcome.why}}));
  };
  if (is_valid_level(command.robot) && is_valid_level(command.type)) {
    gateway_driver_->commands().on_operator_command({who, done}, command.robot, command.type,
                                                    std::move(command.payload), read_clocks());
    return;
  }
  const std::string refusal = "robot and type must be one topic level each";
  Notice notice{
      Severity::notice,
      fmt::format("- {} {} refused: {}; asked by {}", command.robot, command.type, refusal, who),
      escape_unprintable(command.robot), Occasion::command_outcome};
  notice.audit = AuditFacts{who, "command " + escape_unprintable(command.type),
                            std::string(to_string(CommandResult::refused))};
  log_notice(notice);
  done({std::nullopt,
        CommandId::none,
        command.robot,
        command.type,
        CommandResult::refused,
        {},
        refusal});
}

OrderAnswer App::forget(const std::string& who, const std::string& robot) {
  const bool was_known = gateway_.registry().find(robot) != nullptr;
  const std::string problem = gateway_driver_->forget(robot);
  log_notice(audit_notice(who, {"forget", robot}, {{}, problem}));
  if (!problem.empty()) return {{}, problem};
  meshes_.each(&MeshAdapter::forget, robot);
  return {nlohmann::json{{"forgotten", robot}, {"was_known", was_known}}.dump(), {}};
}

void App::manage_store(const std::string& who, StoreOrder order, OrderDone done) {
  OrderDone recorded = record(who, audited(order), std::move(done));
  store_.perform(std::move(order), std::move(recorded));
}

void App::ping(const std::string& robot, OrderDone done) {
  if (gateway_.is_banned(robot)) return done({{}, robot + " is banned (slam-gatewayctl unban)"});
  meshes_.ping(robot, std::move(done));
}

void App::manage_ble(const std::string& who, BleOrder order, OrderDone done) {
  OrderDone recorded = record(who, audited(order), std::move(done));
  if (config_.ble_mesh.provisioning.over_mqtt && std::holds_alternative<PermitJoinOrder>(order))
    recorded = [this, recorded = std::move(recorded)](const OrderAnswer& answer) {
      if (answer.error.empty()) join_requests_driver_->on_ordered(answer, read_clocks());
      recorded(answer);
    };
  meshes_.manage_ble(std::move(order), std::move(recorded));
}

// --- The meshes and the broker -------------------------------------------------------------------

void App::on_mesh_event(MeshEvent event) {
  fleet_.on_mesh_event(event);
  gateway_driver_->on_mesh_event(std::move(event), read_clocks());
}

void App::report_broker_link() {
  gateway_driver_->on_broker_link(read_clocks());
  meshes_.each(&MeshAdapter::on_broker_link, broker_link_.is_up);
  fleet_.on_broker_link(broker_link_.is_up);
  if (border_router_) border_router_->on_broker_link(broker_link_.is_up);
}

void App::on_link_up(const BrokerLimits& limits) {
  const bool is_v5 = upstream_.version() == MqttVersion::v5;
  broker_link_ = {true, read_clocks().wall, {}, broker_uri(upstream_.broker())};
  broker_log_.rename(broker_link_.uri);
  std::string detail = is_v5 ? "MQTT 5" : "MQTT 3.1.1";
  if (const std::string words = to_words(limits); !words.empty()) detail += "; it takes " + words;
  log_notice(broker_log_.on_up(detail));
  // The outbox comes first: otherwise the gateway's own messages would go through the disk.
  outbox_driver_->on_link_up(limits.receive_maximum, read_clocks());
  report_broker_link();
}

void App::on_link_down(const std::string& why) {
  const Now now = read_clocks();
  if (const auto notice = broker_log_.on_down(why, now.mono)) log_notice(*notice);
  if (!note_link_down(why, now)) return;
  outbox_driver_->on_link_down(read_clocks());
  report_broker_link();
}

void App::on_link_left(const std::string& why) {
  log_notice(broker_log_.on_left(why));
  if (!note_link_down(why, read_clocks())) return;
  outbox_driver_->on_link_left(read_clocks());
  report_broker_link();
}

/// Returns false when the link was down already.
bool App::note_link_down(const std::string& why, const Now& now) {
  const bool was_up = std::exchange(broker_link_.is_up, false);
  broker_link_.is_silent = false;
  if (why != broker_link_.why) broker_link_ = {false, now.wall, why, {}};
  return was_up;
}

void App::on_silence(bool is_silent) {
  broker_link_.is_silent = is_silent;
  outbox_driver_->on_silence(is_silent, read_clocks());
  fleet_.on_silence(is_silent);
}

void App::on_published(std::uint64_t sequence) {
  outbox_driver_->on_published(sequence, read_clocks());
}

void App::on_publish_refused(std::uint64_t sequence, const Refusal& refusal) {
  outbox_driver_->on_publish_refused(sequence, refusal, read_clocks());
}

void App::on_subscribe_result(const std::string& filter, bool is_granted) {
  gateway_driver_->on_subscribe_result(filter, is_granted, read_clocks());
}

void App::on_message(BrokerMessage message, const UserProperties& said) {
  message.sender = sender_of(said);
  if (config_.ble_mesh.provisioning.over_mqtt && message.topic == scheme_.join_request_topic())
    return join_requests_driver_->on_request(message, read_clocks());
  if (!meshes_.takes(message) && !fleet_.takes(message))
    gateway_driver_->on_broker_message(std::move(message), read_clocks());
}

void run_gateway(Config config, const std::string& config_file) {
  App(std::move(config), config_file).run();
}

}  // namespace slamgw
