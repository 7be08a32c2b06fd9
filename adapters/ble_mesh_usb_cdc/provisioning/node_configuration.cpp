// SPDX-License-Identifier: Apache-2.0
#include "adapters/ble_mesh_usb_cdc/provisioning/node_configuration.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <iterator>
#include <set>
#include <utility>

namespace slamgw::ble {

namespace {

constexpr ModelId generic_on_off_server{{}, 0x1000};
constexpr ModelId generic_on_off_client{{}, 0x1001};

constexpr std::array servers{ModelId{nordic, 0x0005}, ModelId{nordic, 0x0007},
                             ModelId{nordic, 0x0009}, ModelId{nordic, 0x0000},
                             generic_on_off_server};

/// Returns true for the models that get the application key: those of Nordic's company (among them
/// the thesis's, 5.2.1), for on/off and for health.
bool is_bound(const ModelId& model) {
  return model.company == nordic || model == health_server || model == generic_on_off_server ||
         model == generic_on_off_client;
}

bool is_one_of(const auto& list, const auto& value) {
  return std::ranges::find(list, value) != list.end();
}

bool starts_with(ByteView bytes, ByteView head) {
  return bytes.size() >= head.size() && std::ranges::equal(bytes.first(head.size()), head);
}

bool ends_with(ByteView bytes, const Bytes& tail) {
  return bytes.size() >= tail.size() && std::ranges::equal(bytes.last(tail.size()), tail);
}

/// Returns a request about one model, with `params` between the element and the model. Its answer
/// repeats element and model, whatever its status.
ConfigurationStep model_step(std::string_view what, const Exchange& exchange,
                             const ModelElement& of, const auto&... params) {
  auto step = config_step(fmt::format("{} of model {}", what, to_string(of.model)), exchange,
                          of.element, params..., encode_model_id(of.model));
  step.echoed_tail = encode_model_id(of.model);
  step.is_required = false;
  step.about = of;
  return step;
}

std::vector<std::uint16_t> groups_of(const ConfigurationSettings& settings, const ModelId& model) {
  if (model != sensor_update_client) return settings.groups;
  if (!settings.relay_group) return {};
  return {*settings.relay_group};
}

/// Returns true if the model listens, or hears relayed updates, or did so.
bool may_have_groups(const ConfigurationSettings& settings, const ModelId& model) {
  return is_one_of(servers, model) ||
         (model == sensor_update_client && (settings.relay_group || settings.had_relay_group));
}

/// Asks for the model's groups. A model without support for groups is right if none are wanted.
ConfigurationStep list_step(const ConfigurationSettings& settings, const ModelElement& of) {
  auto step =
      model_step("the list of subscriptions",
                 of.model.company ? vendor_model_subscription_get : sig_model_subscription_get, of);
  step.echoed_tail.clear();
  if (groups_of(settings, of.model).empty()) step.also_done = not_a_subscribe_model;
  return step;
}

bool is_group(std::uint16_t address) { return address >= 0xc000; }

/// Mesh Profile 1.0 section 4.2.2.6: 0 means that nothing is repeated. BlueZ up to 5.66 repeats
/// each message for ever with 0, and sends it once with 1. Nordic's stack repeats with 1, as a new
/// message with a sequence number of its own: the gateway would hear, and report, each of them
/// twice. All of its nodes have a health server, which BlueZ leaves to its applications.
std::uint8_t publish_retransmit_count(const Composition& composition) {
  const bool is_nordics =
      composition.company == nordic && is_one_of(composition.elements.front(), health_server);
  return is_nordics ? 0 : 1;
}

using Steps = std::vector<ConfigurationStep>;

void add_publication(Steps& steps, const ConfigurationSettings& settings, const ModelElement& of) {
  if (!is_one_of(publishers, of.model)) return;
  const std::uint8_t period = of.model == health_server ? period_10_s : std::uint8_t{0};
  const auto wish = settings.wishes.publications.find(to_string(of.model));
  const std::uint16_t destination =
      wish == settings.wishes.publications.end() ? settings.destination : wish->second;
  steps.push_back(model_step("the publication", model_publication_set, of, destination,
                             key_index_0,  // and no friendship credentials
                             std::min(settings.ttl, max_publish_ttl), period,
                             settings.retransmit_count));  // and no interval steps
}

/// Binds the application key to the model. A model that sends gets a publication to the gateway; a
/// model that listens gets groups.
void add_model(Steps& steps, const ConfigurationSettings& settings, const ModelElement& of) {
  steps.push_back(model_step("the key binding", model_app_bind, of, key_index_0));
  add_publication(steps, settings, of);
  if (may_have_groups(settings, of.model)) steps.push_back(list_step(settings, of));
}

/// Asks for the model's publication and its groups.
void add_questions(Steps& steps, const ConfigurationSettings& settings, const ModelElement& of) {
  if (is_one_of(publishers, of.model))
    steps.push_back(model_step("the publication", model_publication_get, of));
  if (may_have_groups(settings, of.model)) steps.push_back(list_step(settings, of));
}

ConfigurationStep composition_step() {
  return config_step("the composition data", composition_data_get, std::uint8_t{0});  // page 0
}

/// Returns a request that sets a state, or asks for it without `state`. The answer is the new
/// state.
ConfigurationStep state_step(std::string what, const Exchange& exchange, const auto&... state) {
  auto step = config_step(std::move(what), exchange, state...);
  step.is_required = false;
  step.expected = octets_of(state...);
  return step;
}

/// Sets the values that an operator has chosen for this node alone.
void add_wishes(Steps& steps, const NodeWishes& wishes) {
  if (wishes.ttl) steps.push_back(state_step("the default TTL", default_ttl_set, *wishes.ttl));
  if (wishes.relay)
    steps.push_back(state_step("relaying", relay_set, std::uint8_t{*wishes.relay},
                               encode_transmissions(relay_transmissions)));
  if (wishes.transmit)
    steps.push_back(state_step("network transmit", network_transmit_set,
                               encode_transmissions(*wishes.transmit)));
}

/// A node that is in another phase than it should be reports that (Mesh Profile 1.0 section
/// 4.3.2.42), and such an answer does not count.
ConfigurationStep phase_step(std::uint8_t transition, std::uint8_t phase) {
  auto step = config_step(fmt::format("key refresh phase {}", transition), key_refresh_phase_set,
                          key_index_0, transition);
  step.echoed_tail = Bytes(1, phase);
  return step;
}

/// Each request may be repeated: nodes answer as if it was the first time.
std::deque<ConfigurationStep> plan_refresh(const RefreshState& refresh) {
  switch (refresh.step) {
    case RefreshStep::none: break;
    case RefreshStep::distributing:
      return {config_step("the new network key", netkey_update, key_index_0, refresh.other.net_key),
              config_step("the new application key", appkey_update, key_indexes_0,
                          refresh.other.app_key)};
    case RefreshStep::switching: return {phase_step(2, 2)};
    case RefreshStep::finishing: return {phase_step(3, 0)};
  }
  return {};
}

std::deque<ConfigurationStep> first_steps(NodeConfiguration::Purpose purpose,
                                          const ConfigurationSettings& settings) {
  using Purpose = NodeConfiguration::Purpose;
  const auto ttl = state_step("its default TTL", default_ttl_get);
  switch (purpose) {
    case Purpose::reset: return {config_step("the node reset", node_reset)};
    case Purpose::refresh: return plan_refresh(settings.refresh);
    case Purpose::ping: return {ttl};
    case Purpose::survey: return {settings.questions.begin(), settings.questions.end()};
    case Purpose::inquire:
      return {ttl, state_step("whether it relays", relay_get),
              state_step("its network transmit", network_transmit_get), composition_step()};
    case Purpose::configure:
    case Purpose::move: break;
  }
  return {composition_step()};
}

/// Returns the steps that leave a model with the groups of the settings, from its present groups.
/// Groups are deleted one by one: Subscription Delete All or Overwrite can stop a robot that runs
/// Nordic's code (all releases) on a failed assertion. That happens if the model has more
/// subscriptions than the robot has subscription lists. Virtual addresses stay: a list has only
/// their hashes, and they are deleted by their label.
Steps plan_groups(const ConfigurationSettings& settings, const ModelElement& of,
                  const std::vector<std::uint16_t>& subscribed) {
  const std::set<std::uint16_t> has(subscribed.begin(), subscribed.end());
  Steps steps;
  const std::vector<std::uint16_t> wanted = groups_of(settings, of.model);
  for (const std::uint16_t group : has)  // first, to make room
    if (is_group(group) && !is_one_of(wanted, group))
      steps.push_back(model_step(fmt::format("the end of the subscription to 0x{:04x}", group),
                                 model_subscription_delete, of, group));
  for (const std::uint16_t group : wanted)
    if (!has.contains(group))
      steps.push_back(model_step(fmt::format("the subscription to 0x{:04x}", group),
                                 model_subscription_add, of, group));
  return steps;
}

}  // namespace

bool ConfigurationStep::is_answered_by(const AccessMessage& message) const {
  if (message.opcode != exchange.answer) return false;
  ByteView params = message.params;
  if (exchange.has_status) {
    if (params.empty()) return false;
    params = params.subspan(1);
  }
  const ByteView echoed = decode_access(request)->params.first(exchange.echoed);
  return starts_with(params, echoed) && ends_with(params, echoed_tail);
}

NodeConfiguration::NodeConfiguration(const Node& node, Purpose purpose,
                                     ConfigurationSettings settings, Radio& radio)
    : purpose_(purpose), settings_(std::move(settings)), address_(node.address), radio_(radio) {
  settings_.had_relay_group =
      node.applied && (node.applied->relay_group || node.applied->is_changing);
  steps_ = first_steps(purpose_, settings_);
  radio_.use_device_key(address_, node.device_key);
}

Duration NodeConfiguration::time_limit() const {
  const bool is_short = purpose_ == Purpose::ping || purpose_ == Purpose::survey;
  return is_short ? ping_time_limit : step_time_limit;
}

/// Returns the steps for the models that have the application key, in the order of the elements.
std::vector<ConfigurationStep> NodeConfiguration::plan(const Composition& composition) {
  settings_.retransmit_count = publish_retransmit_count(composition);
  const bool is_whole = purpose_ == Purpose::configure;
  const auto add = is_whole                    ? add_model
                   : purpose_ == Purpose::move ? add_publication
                                               : add_questions;
  Steps steps;
  if (is_whole)
    steps.push_back(
        config_step("the application key", appkey_add, key_indexes_0, settings_.app_key));
  ModelElement of{address_, {}};
  for (const auto& models : composition.elements) {
    for (const ModelId& model : models) {
      of.model = model;
      if (is_bound(model)) add(steps, settings_, of);
    }
    ++of.element;
  }
  if (is_whole) add_wishes(steps, settings_.wishes);
  return steps;
}

void NodeConfiguration::on_key_used(const std::string& problem, TimePoint now) {
  if (stage_ == Stage::adding_key && problem.empty()) {
    stage_ = Stage::talking;
    talking_since_ = now;
    return begin_step(now);
  }
  if (stage_ == Stage::adding_key) {
    result_ = State::failed;
    problem_ = problem;
  }
  stage_ = Stage::ended;
}

void NodeConfiguration::begin_step(TimePoint now) {
  step_since_ = now;
  send_at_ = now;
  copies_ = 0;
  pause_ = segments_of(steps_.front().request.size()) > 1 ? 2 * first_pause : first_pause;
  last_refusal_.clear();
}

void NodeConfiguration::send_due(TimePoint now) {
  if (stage_ != Stage::talking || now < send_at_) return;
  send_at_ = steps_.front().is_sent_once ? TimePoint::max() : now + pause_;
  pause_ *= 2;
  ++copies_;
  radio_.send(
      {.destination = address_, .payload = steps_.front().request, .is_under_device_key = true},
      now);
}

bool NodeConfiguration::on_message(const MessageReceived& message, TimePoint now) {
  if (stage_ != Stage::talking || message.source != address_ || !message.is_under_device_key)
    return false;
  const auto access = decode_access(message.payload);
  if (!access.has_value()) return false;
  if (!steps_.front().is_answered_by(*access)) return true;  // late, to an earlier request
  if (keeps_answers()) keep(steps_.front(), message, access->params, now);
  on_answer(*access, now);
  return true;
}

void NodeConfiguration::keep(const ConfigurationStep& step, const MessageReceived& from,
                             ByteView params, TimePoint now) {
  answers_.push_back({step.exchange.answer, step.about, Bytes(params.begin(), params.end()),
                      now - step_since_, copies_, from.ttl, from.rssi_dbm});
}

void NodeConfiguration::on_answer(const AccessMessage& message, TimePoint now) {
  const ConfigurationStep step = std::move(steps_.front());
  steps_.pop_front();
  const std::uint8_t status = step.exchange.has_status ? message.params.front() : std::uint8_t{0};
  if (status != 0 && status != step.also_done) {
    const std::string refusal =
        fmt::format("{} was refused: {} (0x{:02x})", step.what, config_status_text(status), status);
    if (step.is_required) return finish(State::failed, refusal);
    add_problem(refusal);
  }
  if (!step.expected.empty() && !std::ranges::equal(message.params, step.expected))
    add_problem(fmt::format("{} was not changed: the node answers {} in place of {}", step.what,
                            to_hex(message.params), to_hex(step.expected)));
  const Opcode answer = step.exchange.answer;
  if (answer == composition_data_get.answer) {
    const auto composition = decode_composition(message.params);
    if (!composition.has_value())
      return finish(State::failed, "its composition data can't be read");
    for (auto& next : plan(*composition)) steps_.push_back(std::move(next));
  }
  const bool lists_groups =
      answer == sig_model_subscription_get.answer || answer == vendor_model_subscription_get.answer;
  if (purpose_ == Purpose::configure && lists_groups && status == 0) {
    auto groups = plan_groups(settings_, *step.about,
                              decode_subscription_list(message.params, step.about->model));
    steps_.insert(steps_.begin(), std::move_iterator(groups.begin()),
                  std::move_iterator(groups.end()));
  }
  if (steps_.empty()) return finish(State::succeeded, std::exchange(problem_, {}));
  begin_step(now);
}

void NodeConfiguration::add_problem(const std::string& problem) {
  problem_ += (problem_.empty() ? "" : "; ") + problem;
}

void NodeConfiguration::on_send_refused(const std::string& why, TimePoint now) {
  if (stage_ != Stage::talking) return;
  last_refusal_ = why;
  if (steps_.front().is_sent_once) return;     // the radio may mean another message
  pause_ = std::max(first_pause, pause_ / 2);  // nothing was sent
  send_at_ = now + refused_pause;
}

void NodeConfiguration::on_beacon(TimePoint now) {
  if (stage_ == Stage::talking && purpose_ == Purpose::reset && now - step_since_ >= reset_time)
    finish(State::succeeded, {});
}

std::optional<TimePoint> NodeConfiguration::deadline() const {
  if (stage_ != Stage::talking) return std::nullopt;
  return std::min({send_at_, step_since_ + time_limit(), talking_since_ + longest});
}

void NodeConfiguration::on_deadline(TimePoint now) {
  if (stage_ != Stage::talking) return;
  if (now >= talking_since_ + longest)
    return finish(State::failed,
                  fmt::format("it did not end in {} min",
                              std::chrono::duration_cast<std::chrono::minutes>(longest).count()));
  if (now < step_since_ + time_limit()) return;
  std::string why =
      fmt::format("no answer to {} in {} s", steps_.front().what,
                  std::chrono::duration_cast<std::chrono::seconds>(time_limit()).count());
  if (!last_refusal_.empty()) why += " (" + last_refusal_ + ")";
  finish(State::failed, std::move(why));
}

void NodeConfiguration::finish(State result, std::string problem) {
  result_ = result;
  problem_ = std::move(problem);
  stage_ = Stage::removing_key;
  radio_.forget_device_key(address_);
}

}  // namespace slamgw::ble
