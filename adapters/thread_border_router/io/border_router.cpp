// SPDX-License-Identifier: Apache-2.0
#include "adapters/thread_border_router/io/border_router.hpp"

#include <fmt/format.h>

#include <array>
#include <type_traits>
#include <utility>
#include <variant>

#include "daemon/core/result.hpp"

namespace slamgw::border_router {
namespace {

// ot-br-posix: src/dbus/server/introspect.xml and src/dbus/common/constants.hpp.
constexpr const char* service = "io.openthread.BorderRouter.wpan0";
constexpr const char* object = "/io/openthread/BorderRouter/wpan0";
constexpr const char* interface = "io.openthread.BorderRouter";
constexpr const char* properties_interface = "org.freedesktop.DBus.Properties";
/// The agent answers at once. One property without an answer must not hold the others back for
/// sd-bus's 25 s.
constexpr std::uint64_t answer_limit_us = 3'000'000;

template <auto member>
bool read_value(sd_bus_message* message, const char* type, NodeFacts& facts) {
  using Value = typename std::remove_reference_t<decltype(facts.*member)>::value_type;
  using Raw = std::conditional_t<std::is_same_v<Value, std::string>, const char*, Value>;
  Raw raw{};
  if (sd_bus_message_read(message, "v", type, &raw) <= 0) return false;
  facts.*member = raw;
  return true;
}

bool read_leader(sd_bus_message* message, const char* type, NodeFacts& facts) {
  std::uint32_t partition = 0;
  std::uint8_t weight = 0, version = 0, stable_version = 0, router = 0;
  if (sd_bus_message_read(message, "v", type, &partition, &weight, &version, &stable_version,
                          &router) <= 0)
    return false;
  facts.partition_id = partition;
  facts.leader_router_id = router;
  return true;
}

/// Returns false at the end of the table. D-Bus carries the signal strengths as octets.
bool read_neighbour(sd_bus_message* message, Neighbour& to) {
  std::uint32_t age_s = 0, frame_counter = 0, mle_frame_counter = 0;
  std::uint8_t average = 0, last = 0;
  std::uint16_t message_errors = 0, version = 0;
  int is_always_on = 0, is_full = 0, has_full_data = 0, is_child = 0;
  if (sd_bus_message_read(message, "(tuquuyyyqqqbbbb)", &to.extended_address, &age_s, &to.rloc16,
                          &frame_counter, &mle_frame_counter, &to.link_quality, &average, &last,
                          &to.frame_errors, &message_errors, &version, &is_always_on, &is_full,
                          &has_full_data, &is_child) <= 0)
    return false;
  to.rssi_average_dbm = static_cast<std::int8_t>(average);
  to.rssi_last_dbm = static_cast<std::int8_t>(last);
  to.is_always_on = is_always_on != 0;
  to.is_child = is_child != 0;
  return true;
}

bool read_neighbours(sd_bus_message* message, const char* type, NodeFacts& facts) {
  if (sd_bus_message_enter_container(message, 'v', type) <= 0) return false;
  if (sd_bus_message_enter_container(message, 'a', type + 1) <= 0) return false;
  facts.neighbours.emplace();
  for (Neighbour neighbour; read_neighbour(message, neighbour);) {
    if (facts.neighbours->size() < NodeFacts::max_neighbours)
      facts.neighbours->push_back(neighbour);
    else
      ++facts.left_out;
  }
  return true;
}

struct Property {
  const char* name;
  const char* type;
  bool (*read)(sd_bus_message* reply, const char* type, NodeFacts& facts);
};
constexpr std::array<Property, 7> properties{{
    {"DeviceRole", "s", read_value<&NodeFacts::role>},
    {"NetworkName", "s", read_value<&NodeFacts::network_name>},
    {"Channel", "q", read_value<&NodeFacts::channel>},
    {"Rloc16", "q", read_value<&NodeFacts::rloc16>},
    {"ExtendedAddress", "t", read_value<&NodeFacts::extended_address>},
    {"LeaderData", "(uyyyy)", read_leader},
    {"NeighborTable", "a(tuquuyyyqqqbbbb)", read_neighbours},  // before November 2022: one "q" less
}};

/// An error is normal for a property that the present state does not have: a detached node has no
/// leader. But each state has a role.
void take(const Property& property, sd_bus_message* reply, NodeFacts& facts) {
  if (const sd_bus_error* const error = sd_bus_message_get_error(reply)) {
    if (&property == &properties.front())
      facts.problem = fmt::format("does not report its role: {}", error->name);
    return;
  }
  if (!property.read(reply, property.type, facts))
    facts.problem =
        fmt::format("its {} is not of type {}; it is ignored", property.name, property.type);
}

}  // namespace

BorderRouter::BorderRouter(boost::asio::io_context& io,
                           std::function<void(const std::string& json)> publish,
                           std::function<void(Notice&)> report, std::string bus_address)
    : driver_(
          io, watch_,
          [this, publish = std::move(publish), report = std::move(report)](WatchAction& action) {
            std::visit(overloaded{
                           [this](const ReadNode&) { read(); },
                           [&](const PublishDocument& document) { publish(document.json); },
                           [&](Notice& notice) { report(notice); },
                       },
                       action);
          }),
      connection_(io, std::move(bus_address), service,
                  {[this](sd_bus* bus) {
                     return sd_bus_match_signal_async(bus, nullptr, service, object,
                                                      properties_interface, "PropertiesChanged",
                                                      on_signal, nullptr, this);
                   },
                   [this](const std::string&) { on_agent(); }}),
      calls_(properties.size()) {}

void BorderRouter::on_agent() {
  forget_calls();
  if (connection_.owner().empty()) return driver_->on_gone();
  driver_->on_came(read_clocks().mono);
}

void BorderRouter::stop() {
  driver_.stop();
  forget_calls();
  connection_.close();
}

void BorderRouter::forget_calls() {
  for (Call& call : calls_) call.slot.reset();
  waiting_ = 0;
}

void BorderRouter::read() {
  facts_ = {};
  for (std::size_t i = 0; i < properties.size(); ++i) {
    const SdBusMessage message = connection_.call(object, properties_interface, "Get");
    sd_bus_message_append(message.get(), "ss", interface, properties[i].name);
    sd_bus_slot* slot = nullptr;
    calls_[i].router = this;
    if (sd_bus_call_async(connection_.bus(), &slot, message.get(), on_reply, &calls_[i],
                          answer_limit_us) >= 0)
      ++waiting_;
    calls_[i].slot.reset(slot);
  }
  if (waiting_ == 0) driver_->on_read({}, read_clocks().mono);
  connection_.watch();
}

int BorderRouter::on_reply(sd_bus_message* reply, void* call, sd_bus_error*) {
  BorderRouter& self = *static_cast<Call*>(call)->router;
  const auto index = static_cast<Call*>(call) - self.calls_.data();
  take(properties[static_cast<std::size_t>(index)], reply, self.facts_);
  if (--self.waiting_ == 0)
    self.driver_->on_read(std::exchange(self.facts_, {}), read_clocks().mono);
  return 0;
}

/// Reads no value of the signal: one of them, ActiveDatasetTlvs, holds the network's key.
int BorderRouter::on_signal(sd_bus_message* signal, void* router, sd_bus_error*) {
  BorderRouter& self = *static_cast<BorderRouter*>(router);
  const char* const sender = sd_bus_message_get_sender(signal);
  if (sender != nullptr && self.connection_.owner() == sender)
    self.driver_->on_changed(read_clocks().mono);
  return 0;
}

}  // namespace slamgw::border_router
