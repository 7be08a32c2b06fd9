// SPDX-License-Identifier: Apache-2.0
#include "tests/thread_border_router/fake_otbr_agent.hpp"

#include <gtest/gtest.h>

#include "tests/support/private_bus.hpp"

namespace slamgw::test {
namespace {

constexpr const char* name = "io.openthread.BorderRouter.wpan0";
constexpr const char* path = "/io/openthread/BorderRouter/wpan0";
constexpr const char* agent_interface = "io.openthread.BorderRouter";

}  // namespace

void FakeOtbrAgent::come() {
  bus_ = connect_to_bus(address_);
  ASSERT_TRUE(bus_);
  ASSERT_GE(sd_bus_add_object(bus_.get(), nullptr, path, on_call, this), 0);
  ASSERT_GE(sd_bus_request_name(bus_.get(), name, 0), 0);
}

void FakeOtbrAgent::process() {
  while (bus_ && sd_bus_process(bus_.get(), nullptr) > 0) {
  }
}

void FakeOtbrAgent::change_role(const std::string& to) {
  role = to;
  ASSERT_GE(
      sd_bus_emit_signal(bus_.get(), path, "org.freedesktop.DBus.Properties", "PropertiesChanged",
                         "sa{sv}as", agent_interface, 1, "DeviceRole", "s", role.c_str(), 0),
      0);
}

int FakeOtbrAgent::on_call(sd_bus_message* call, void* self, sd_bus_error* error) {
  FakeOtbrAgent& agent = *static_cast<FakeOtbrAgent*>(self);
  const char *interface = nullptr, *property = nullptr;
  if (sd_bus_message_is_method_call(call, "org.freedesktop.DBus.Properties", "Get") <= 0) {
    agent.asked.insert(sd_bus_message_get_member(call));
    return 0;
  }
  EXPECT_GT(sd_bus_message_read(call, "ss", &interface, &property), 0);
  EXPECT_STREQ(interface, agent_interface);
  agent.asked.insert(property);
  if (property == agent.unanswered) return 1;
  return agent.get(call, property, error);
}

int FakeOtbrAgent::get(sd_bus_message* call, const std::string& property,
                       sd_bus_error* error) const {
  const bool is_attached = role != "detached" && role != "disabled";
  sd_bus_message* made = nullptr;
  sd_bus_message_new_method_return(call, &made);
  const SdBusMessage reply(made);
  if (property == "DeviceRole") {
    sd_bus_message_append(made, "v", "s", role.c_str());
  } else if (property == "NetworkName") {
    sd_bus_message_append(made, "v", "s", network_name.c_str());
  } else if (property == "Channel") {
    sd_bus_message_append(made, "v", "q", 15);
  } else if (property == "Rloc16") {
    sd_bus_message_append(made, "v", "q", is_attached ? 0x4400 : 0xfffe);
  } else if (property == "ExtendedAddress") {
    sd_bus_message_append(made, "v", "t", extended_address);
  } else if (property == "LeaderData" && is_attached) {
    sd_bus_message_append(made, "v", "(uyyyy)", 0x1a2b3c4d, 64, 10, 20, 17);
  } else if (property == "NeighborTable") {
    append_neighbours(made);
  } else {
    return sd_bus_error_set(error, "io.openthread.Error.Detached", "");
  }
  return sd_bus_send(nullptr, made, nullptr);
}

void FakeOtbrAgent::append_neighbours(sd_bus_message* reply) const {
  const std::string entry = table_type.substr(1);
  sd_bus_message_open_container(reply, 'v', table_type.c_str());
  sd_bus_message_open_container(reply, 'a', entry.c_str());
  for (const Neighbour& each : neighbours) {
    sd_bus_message_open_container(reply, 'r', entry.substr(1, entry.size() - 2).c_str());
    sd_bus_message_append(reply, "tuquuyyyqq", each.extended_address, 7, each.rloc16, 123, 45,
                          each.link_quality, static_cast<std::uint8_t>(each.average_dbm),
                          static_cast<std::uint8_t>(each.average_dbm - 1), 655, 0);
    if (table_type != older_table) sd_bus_message_append(reply, "q", 4);
    sd_bus_message_append(reply, "bbbb", each.is_always_on, 0, 0, each.is_child);
    sd_bus_message_close_container(reply);
  }
  sd_bus_message_close_container(reply);
  sd_bus_message_close_container(reply);
}

}  // namespace slamgw::test
