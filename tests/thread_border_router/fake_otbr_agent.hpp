// SPDX-License-Identifier: Apache-2.0
// otbr-agent on a bus, as ot-br-posix 2026.08 answers there. It returns its properties one by one,
// with the types of its source (src/dbus/server/introspect.xml). It returns errors for properties
// without a value.
#pragma once

#include <cstdint>
#include <set>
#include <string>
#include <vector>

#include "daemon/runtime/bus_connection.hpp"

namespace slamgw::test {

class FakeOtbrAgent {
 public:
  static constexpr const char* older_table = "a(tuquuyyyqqbbbb)";  // until November 2022

  struct Neighbour {
    std::uint64_t extended_address = 0;
    std::uint16_t rloc16 = 0;
    std::uint8_t link_quality = 3;
    std::int8_t average_dbm = -60;
    bool is_always_on = true;
    bool is_child = true;
  };

  explicit FakeOtbrAgent(std::string bus_address) : address_(std::move(bus_address)) {}

  void come();
  void leave() { bus_.reset(); }
  /// Answers calls from the bus.
  void process();
  /// Reports a new role, as otbr-agent does.
  void change_role(const std::string& to);

  std::string role = "leader";
  std::string network_name = "SLAM";
  std::uint64_t extended_address = 0xd2e15a0c0b0a0908;
  std::string table_type = "a(tuquuyyyqqqbbbb)";
  std::vector<Neighbour> neighbours;
  std::string unanswered;       ///< a property that hangs
  std::set<std::string> asked;  ///< properties, and other calls by their names

 private:
  static int on_call(sd_bus_message* call, void* self, sd_bus_error* error);
  int get(sd_bus_message* call, const std::string& property, sd_bus_error* error) const;
  void append_neighbours(sd_bus_message* reply) const;

  std::string address_;
  SdBus bus_;
};

}  // namespace slamgw::test
