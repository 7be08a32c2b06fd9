// SPDX-License-Identifier: Apache-2.0
#include "web/server/io/page_hub.hpp"

#include <fmt/format.h>
#include <sys/resource.h>
#include <unistd.h>

#include <algorithm>
#include <boost/asio/post.hpp>
#include <fstream>
#include <nlohmann/json.hpp>
#include <utility>

#include "daemon/observability/log.hpp"
#include "web/server/io/page_connection.hpp"

namespace slamgw::web {
namespace {

constexpr std::size_t max_sent = 100;  // commands whose refusal by the broker can be reported

std::string site_json(const Config& config, const std::string& version) {
  nlohmann::json origins = nlohmann::json::object();
  for (const RobotName& robot : config.robots) {
    if (robot.origin)
      origins[robot.id] = {{"x_cm", robot.origin->x_cm},
                           {"y_cm", robot.origin->y_cm},
                           {"heading_deg", robot.origin->heading_deg}};
  }
  return nlohmann::json{{"version", version},
                        {"prefix", config.topics.prefix},
                        {"gateway", config.gateway_id},
                        {"origins", std::move(origins)}}
      .dump();
}

/// Lists all brokers, because the link decides which of them is used.
std::string broker_uri(const BrokerSettings& broker) {
  std::string text;
  for (const BrokerAddress& address : broker.addresses())
    text += (text.empty() ? "" : ", ") + address.uri();
  return text;
}

std::uint64_t resident_bytes() {
  std::uint64_t total_pages = 0;
  std::uint64_t resident_pages = 0;
  std::ifstream("/proc/self/statm") >> total_pages >> resident_pages;
  return resident_pages * static_cast<std::uint64_t>(sysconf(_SC_PAGESIZE));
}

double cpu_seconds() {
  rusage usage{};
  getrusage(RUSAGE_SELF, &usage);
  const auto seconds = [](const timeval& time) {
    return static_cast<double>(time.tv_sec) + 1e-6 * static_cast<double>(time.tv_usec);
  };
  return seconds(usage.ru_utime) + seconds(usage.ru_stime);
}

/// The clock of BrokerMessage::at_ms.
std::int64_t now_ms() {
  using namespace std::chrono;
  return duration_cast<milliseconds>(system_clock::now().time_since_epoch()).count();
}

SharedText share(std::string text) { return std::make_shared<const std::string>(std::move(text)); }

std::vector<std::string> filters(const std::string& prefix) {
  return {prefix + "/gateway/#", prefix + "/robot/#", prefix + "/server/#"};
}

}  // namespace

PageHub::PageHub(boost::asio::io_context& io, const Config& config, Tokens tokens,
                 std::string version)
    : topics_(config.topics.prefix),
      tokens_(std::move(tokens)),
      site_(site_json(config, version)),
      broker_(broker_uri(config.broker)),
      known_(fmt::format("{}/gateway/{}/", config.topics.prefix, config.gateway_id)),
      own_{.version = std::move(version)},
      io_(io),
      roster_timer_(io),
      link_(io, config.broker, filters(config.topics.prefix),
            {[this](const BrokerMessage& message) {
               ++own_.messages;
               on_message(message);
             },
             [this](bool is_up, const std::string& why) { on_broker(is_up, why); },
             [this](std::uint64_t command, const std::string& why) { on_refused(command, why); },
             [this](const std::string& filter, const std::string& why) {
               on_unreadable(filter, why);
             }}) {
  roster_timer_.every(roster_period, [this] { update_roster(); });
}

std::string PageHub::locked_greeting() {
  return own_message("hello", R"({"takes_token":true,"needs_token":true})");
}

void PageHub::join(PageConnection& page) {
  if (!pages_.insert(&page).second) return;
  page.send_state("$web/hello", share(greeting()));
  page.send_state("$web/broker", share(broker_state()));
  for (const auto& [topic, text] : known_.topics()) page.send_state(topic, text);
  for (const auto& [name, text] : roster_.texts()) page.send_state("$web/" + name, text);
}

void PageHub::leave(PageConnection& page) { pages_.erase(&page); }

void PageHub::report_taken_share(const Client& client) {
  if (taken_shares_.add(client, std::chrono::steady_clock::now()) > 1) return;
  log_event(Severity::warning,
            client.name + " has as many connections as one address may have: more are refused");
}

std::string PageHub::publish(const CommandRequest& command) {
  const auto number = link_.publish(command);
  if (!number) return refusal(command.topic, "no connection to the broker: " + why_);
  ++own_.commands;
  sent_.emplace_back(*number, command.topic);
  if (sent_.size() > max_sent) sent_.pop_front();
  log_event(Severity::info,
            fmt::format("{} sent a command on {} over the page", command.sender, command.topic));
  return {};
}

void PageHub::on_message(const BrokerMessage& message) {
  const TopicKind kind = topics_.kind_of(message.topic);
  if (kind == TopicKind::robot && !message.is_retained) on_robot_message(message);
  if (kind == TopicKind::robot && pages_.empty()) return;
  auto page_text = to_page(message, kind);
  if (kind == TopicKind::foreign || !page_text) return;
  const SharedText text = share(std::move(*page_text));
  if (kind == TopicKind::state && !keep(message, text)) return;
  if (kind == TopicKind::state) pass_to_roster(message);
  const auto [gateway, rest] = topics_.gateway_topic(message.topic);
  if (rest.starts_with("commands/") &&
      known_.topics().contains(fmt::format("{}/gateway/{}/state", topics_.prefix(), gateway)))
    outcomes_.add(gateway, message.payload);
  const bool is_event = kind == TopicKind::event || kind == TopicKind::command;
  if (is_event && !message.is_retained) past_.on_event(text, message.at_ms);
  for (PageConnection* page : pages_) {
    if (kind == TopicKind::state)
      page->send_state(message.topic, text);
    else
      page->send_event(text);
  }
}

void PageHub::on_robot_message(const BrokerMessage& message) {
  const std::string_view robot = topics_.robot_of(message.topic);
  roster_.on_robot_message(robot, message.gateway, message.received_at, message.at_ms);
  if (message.topic.size() <= max_topic && message.topic.ends_with("/update"))
    past_.on_update(robot, message.payload, message.at_ms);
}

std::vector<std::pair<std::string, SharedText>> PageHub::past(std::int64_t since_ms) const {
  return past_.texts(since_ms, now_ms());
}

void PageHub::pass_to_roster(const BrokerMessage& message) {
  const Topics::GatewayTopic topic = topics_.gateway_topic(message.topic);
  roster_.on_document(topic, message.payload, message.at_ms, message.is_retained);
  if (topic.rest == "numbers")
    history_.on_numbers(roster_, topic.gateway, message.payload, message.at_ms);
}

SharedText PageHub::history_of(const std::string& robot) const {
  return share(own_message("history", history_.text(robot, now_ms())));
}

bool PageHub::keep(const BrokerMessage& message, const SharedText& text) {
  if (!message.payload.empty()) {
    const bool has_room = known_.keep(message.topic, text);
    if (!has_room) on_message({message.topic, {}, message.at_ms, false, {}, {}, {}});
    return has_room;
  }
  if (!known_.forget(message.topic)) return false;  // a retained message was withdrawn
  const auto [gateway, rest] = topics_.gateway_topic(message.topic);
  for (const std::string_view each :
       {std::string_view("stats"), std::string_view("numbers"), Topics::join_response}) {
    if (rest == "state")
      known_.forget(fmt::format("{}/gateway/{}/{}", topics_.prefix(), gateway, each));
  }
  return true;
}

void PageHub::update_roster() {
  for (const auto& [name, text] : roster_.update(now_ms()))
    for (PageConnection* page : pages_) page->send_state("$web/" + name, text);
  history_.update(roster_, now_ms());
}

/// Forgets all states, because some may have been withdrawn while the connection was away. The
/// broker now sends all states again.
void PageHub::reset_pages() {
  known_.forget_all();
  const SharedText text = share(greeting());
  for (PageConnection* page : pages_) page->send_reset("$web/hello", text);
}

void PageHub::on_broker(bool is_up, const std::string& why) {
  own_.broker_is_connected = is_up;
  why_ = why;
  if (is_up)
    roster_.on_broker_found();
  else
    roster_.on_broker_lost(now_ms());
  if (is_up && std::exchange(was_connected_, true)) reset_pages();
  if (is_up)
    log_event(Severity::notice, "connected to the broker at " + broker_);
  else
    log_event(Severity::warning,
              fmt::format("no connection to the broker at {}: {}", broker_, why));
  unreadable_.clear();
  send_broker_state();
}

void PageHub::on_unreadable(const std::string& filter, const std::string& why) {
  log_event(Severity::warning,
            fmt::format("the broker does not let this program read {}: {}", filter, why));
  unreadable_[filter] = why;
  send_broker_state();
}

void PageHub::send_broker_state() {
  const SharedText text = share(broker_state());
  for (PageConnection* page : pages_) page->send_state("$web/broker", text);
}

void PageHub::on_refused(std::uint64_t command, const std::string& why) {
  const auto sent = std::find_if(sent_.begin(), sent_.end(),
                                 [&](const auto& entry) { return entry.first == command; });
  if (sent == sent_.end()) return;
  log_event(Severity::warning, fmt::format("the broker refused {}: {}", sent->second, why));
  const SharedText text = share(refusal(sent->second, "the broker refused it: " + why));
  for (PageConnection* page : pages_) page->send_event(text);
  sent_.erase(sent);
}

std::string PageHub::greeting() const {
  std::string payload = site_;
  payload.pop_back();
  payload += fmt::format(R"(,"takes_token":{},"now":{}}})", !tokens_.empty(), now_ms());
  return own_message("hello", payload);
}

std::string PageHub::broker_state() const {
  const nlohmann::json state{{"uri", broker_},
                             {"state", own_.broker_is_connected ? "up" : "down"},
                             {"why", why_},
                             {"unreadable", unreadable_}};
  return own_message("broker",
                     state.dump(-1, ' ', false, nlohmann::json::error_handler_t::replace));
}

std::shared_ptr<void> PageHub::begin_scrape() {
  return scrape_.use_count() <= max_scrapes ? scrape_ : nullptr;
}

void PageHub::make_metrics(std::function<void(std::string)> done) {
  update_roster();
  own_.pages = pages_.size();
  own_.wrong_tokens = guesses_.total();
  own_.cpu_seconds = cpu_seconds();
  own_.resident_bytes = resident_bytes();
  boost::asio::post(metrics_thread_, [this, own = own_, known = known_, roster = roster_,
                                      outcomes = outcomes_, done = std::move(done)]() mutable {
    std::string text = metrics_text(own, topics_, known, roster, outcomes);
    boost::asio::post(
        io_, [text = std::move(text), done = std::move(done)]() mutable { done(std::move(text)); });
  });
}

}  // namespace slamgw::web
