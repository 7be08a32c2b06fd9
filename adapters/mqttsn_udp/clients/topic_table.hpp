// SPDX-License-Identifier: Apache-2.0
// The normal topic ids of one client (MQTT-SN 1.2 section 6.5): its own numbers (R59), the same for
// REGISTER and SUBSCRIBE (R61), never changed or reused while the session lives.
#pragma once

#include <cstdint>
#include <map>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

namespace slamgw::mqttsn {

class TopicTable {
 public:
  /// The id of `name`, assigned on first use: 0x0001 and up. Nothing when the table is full.
  std::optional<std::uint16_t> assign(std::string_view name);
  /// Nothing for an id that was never given out.
  const std::string* name_of(std::uint16_t id) const;
  std::optional<std::uint16_t> id_of(std::string_view name) const;

  /// Whether the client has been told this id in its present connection (R48, R65).
  bool is_told(std::uint16_t id) const;
  void set_told(std::uint16_t id, bool told);
  void set_all_untold();

  struct Topic {
    std::string name;
    bool is_told = false;
  };
  /// In the order of their ids, from 1.
  const std::vector<Topic>& topics() const { return topics_; }
  void clear();

 private:
  std::vector<Topic> topics_;
  std::map<std::string, std::uint16_t, std::less<>> ids_;
};

}  // namespace slamgw::mqttsn
