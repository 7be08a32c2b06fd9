// SPDX-License-Identifier: Apache-2.0
#include "adapters/mqttsn_udp/io/lan_announcement.hpp"

#include <fmt/format.h>

#include <utility>

// Follows avahi-common/defs.h, "How to Register Services" and "How to Write a Client That Can Deal
// with Daemon Restarts".
namespace slamgw::mqttsn {
namespace {

constexpr const char* service_type = "_mqttsn._udp";
constexpr const char* server = "org.freedesktop.Avahi.Server";
constexpr const char* entry_group = "org.freedesktop.Avahi.EntryGroup";
constexpr const char* collision_error = "org.freedesktop.Avahi.CollisionError";

constexpr int server_is_running = 2;
constexpr int group_is_established = 2;
constexpr int group_has_collided = 3;
constexpr int group_has_failed = 4;

constexpr int any = -1;  // interface, protocol
constexpr int ipv4 = 0;
constexpr unsigned no_flags = 0;

}  // namespace

LanAnnouncement::LanAnnouncement(boost::asio::io_context& io, std::string bus_address,
                                 std::function<void(Notice)> report)
    : report_(std::move(report)),
      connection_(io, std::move(bus_address), "org.freedesktop.Avahi",
                  {{}, [this](const std::string& fault) { on_avahi(fault); }}) {}

void LanAnnouncement::announce(Service service) {
  withdraw();
  service_ = std::move(service);
  connection_.open();
}

void LanAnnouncement::withdraw() {
  forget_group();
  connection_.close();
}

void LanAnnouncement::forget_group() {
  for (SdBusSlot* slot : {&host_names_, &states_, &call_}) slot->reset();
  group_.clear();
  name_number_ = 1;
}

void LanAnnouncement::report(Severity severity, std::string text) {
  if (text != std::exchange(reported_, text)) report_(Notice{severity, std::move(text), {}});
}

void LanAnnouncement::on_avahi(const std::string& fault) {
  forget_group();
  if (connection_.owner().empty())
    return report(Severity::notice,
                  fmt::format("mqttsn.announce waits: {}",
                              fault.empty() ? "avahi-daemon is not running" : fault));
  sd_bus_slot* slot = nullptr;
  sd_bus_match_signal_async(connection_.bus(), &slot, connection_.owner().c_str(), "/", server,
                            "StateChanged", on_host_name, nullptr, this);
  host_names_.reset(std::exchange(slot, nullptr));
  sd_bus_call_async(connection_.bus(), &slot, connection_.call("/", server, "EntryGroupNew").get(),
                    on_group, this, 0);
  call_.reset(slot);
}

/// Adds the service again when the host's name has changed or become certain: records contain it.
int LanAnnouncement::on_host_name(sd_bus_message* message, void* self, sd_bus_error*) {
  LanAnnouncement& announcement = *static_cast<LanAnnouncement*>(self);
  int state = 0;
  sd_bus_message_read(message, "i", &state);
  if (state != server_is_running || announcement.group_.empty()) return 0;
  announcement.name_number_ = 1;
  announcement.add();
  return 0;
}

int LanAnnouncement::on_group(sd_bus_message* reply, void* self, sd_bus_error*) {
  LanAnnouncement& announcement = *static_cast<LanAnnouncement*>(self);
  const BusConnection& connection = announcement.connection_;
  const char* path = "";
  if (sd_bus_message_is_method_error(reply, nullptr) > 0 ||
      sd_bus_message_read(reply, "o", &path) < 0)
    return on_added(reply, self, nullptr);
  announcement.group_ = path;
  sd_bus_slot* slot = nullptr;
  sd_bus_match_signal_async(connection.bus(), &slot, connection.owner().c_str(), path, entry_group,
                            "StateChanged", on_state, nullptr, self);
  announcement.states_.reset(slot);
  announcement.add();
  return 0;
}

/// Avahi takes these calls in order. If AddService fails, Commit fails, too, with no effect.
void LanAnnouncement::add() {
  sd_bus* const bus = connection_.bus();
  const auto call = [&](const char* member) {
    return connection_.call(group_.c_str(), entry_group, member);
  };
  std::string name = service_.name;
  if (name_number_ > 1) name += fmt::format(" #{}", name_number_);
  const SdBusMessage addition = call("AddService");
  sd_bus_message_append(addition.get(), "iiussssqaay",
                        service_.interface > 0 ? service_.interface : any,
                        service_.is_ipv4_only ? ipv4 : any, no_flags, name.c_str(), service_type,
                        "", "", service_.port, 0);
  sd_bus_slot* slot = nullptr;
  sd_bus_send(bus, call("Reset").get(), nullptr);
  sd_bus_call_async(bus, &slot, addition.get(), on_added, this, 0);
  sd_bus_send(bus, call("Commit").get(), nullptr);
  call_.reset(slot);
}

/// A collision here means that another service of this host has the name.
int LanAnnouncement::on_added(sd_bus_message* reply, void* self, sd_bus_error*) {
  LanAnnouncement& announcement = *static_cast<LanAnnouncement*>(self);
  const sd_bus_error* const error = sd_bus_message_get_error(reply);
  if (sd_bus_error_has_name(error, collision_error) > 0) {
    announcement.rename();
  } else if (error != nullptr) {
    announcement.report(Severity::warning,
                        fmt::format("mqttsn.announce: Avahi refused the service: {}",
                                    error->message != nullptr ? error->message : error->name));
  }
  return 0;
}

int LanAnnouncement::on_state(sd_bus_message* message, void* self, sd_bus_error*) {
  LanAnnouncement& announcement = *static_cast<LanAnnouncement*>(self);
  const Service& service = announcement.service_;
  int state = 0;
  const char* error = "";
  sd_bus_message_read(message, "is", &state, &error);
  if (state == group_has_collided) announcement.rename();
  if (state == group_has_failed)
    announcement.report(Severity::warning, fmt::format("mqttsn.announce: Avahi failed: {}", error));
  if (state == group_is_established)
    announcement.report(
        Severity::notice,
        fmt::format(
            "MQTT-SN is announced on the LAN as '{}{}' ({}, port {})", service.name,
            announcement.name_number_ > 1 ? fmt::format(" #{}", announcement.name_number_) : "",
            service_type, service.port));
  return 0;
}

void LanAnnouncement::rename() {
  if (name_number_ < max_names) {
    ++name_number_;
    return add();
  }
  report(Severity::warning, fmt::format("mqttsn.announce: {} names like '{}' are taken on the LAN",
                                        max_names, service_.name));
}

}  // namespace slamgw::mqttsn
