// SPDX-License-Identifier: Apache-2.0
// The normal topic ids of one client (MQTT-SN 1.2 section 6.5): its own numbers (R59), the same for
// REGISTER and SUBSCRIBE (R61). Ids are made from the names, because CONNACK cannot say that a
// session is not there. A robot may continue at a gateway with an older session of it, or none. Its
// ids then mean the same topics there, or unknown ones. An id that the client has asked for or
// publishes with keeps its name while the session lives. When the table is full, the gateway reuses
// the id of its own deliveries that was unused for longest.
#pragma once

#include <cstddef>
#include <cstdint>
#include <functional>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "adapters/mqttsn_udp/limits.hpp"

namespace slamgw::mqttsn {

/// The memory that topic names and filters of all clients may take together. Each client has a
/// small part that others can't take; the rest is shared.
class NameBudget {
 public:
  /// Octets that a topic of this length takes with its place in the table.
  static constexpr std::size_t of_topic(std::size_t length) { return length + 128; }
  /// Octets that a subscription takes: it stands here and in the robot's session at the broker
  /// (daemon/sessions).
  static constexpr std::size_t of_filter(std::size_t length) { return 2 * length + 512; }

  /// Whether a client that holds `held` octets may take `octets` more.
  bool may_take(std::size_t held, std::size_t octets) const {
    return held + octets <= limits::name_octets_for_each ||
           taken_ + octets <= limits::name_octets_together;
  }
  /// Whether `octets` that were held before a restart may be taken again, with this many `clients`
  /// back. Clients return in another order, and each had a small part for topics and one for
  /// filters.
  bool may_restore(std::size_t clients, std::size_t octets) const {
    return taken_ + octets <=
           limits::name_octets_together + 2 * clients * limits::name_octets_for_each;
  }
  void take(std::size_t octets) { taken_ += octets; }
  void give_back(std::size_t octets) { taken_ -= octets; }

 private:
  std::size_t taken_ = 0;
};

/// Returns the new name of a topic; nothing when it keeps its name.
using NewName = std::function<std::optional<std::string>(const std::string& topic)>;

/// Returns the id that a topic gets if it is free, from lowest_topic_id to highest_new_topic_id.
using TopicIdOf = std::uint16_t (*)(std::string_view name);
inline constexpr std::uint16_t lowest_topic_id = 1;
/// Some clients keep topic ids in signed 16-bit numbers and fail on negative ones.
inline constexpr std::uint16_t highest_new_topic_id = 0x7fff;
/// Sessions that version 0.1.0 has kept may have any valid id (section 5.3.11).
inline constexpr std::uint16_t highest_topic_id = 0xfffe;
/// A hash. Of 10 topics of a robot, two want the same id once in 730 times. Only then do the ids
/// depend on which topic came first.
std::uint16_t topic_id_of(std::string_view name);

class TopicTable {
 public:
  TopicTable() = default;
  TopicTable(const TopicTable&) = delete;
  TopicTable& operator=(const TopicTable&) = delete;
  ~TopicTable() { clear(); }

  /// Charges names to `budget` from now on; it must outlive the table.
  void charge(NameBudget& budget) { budget_ = &budget; }
  /// Sets the function that chooses the ids of new topics.
  void number_by(TopicIdOf wanted_id) { wanted_id_ = wanted_id; }

  /// Returns the id of `name`, assigned on first use. Returns nothing when the table is full and no
  /// topic can be forgotten for it. A topic whose id is `in_use` is never forgotten.
  std::optional<std::uint16_t> assign(std::string_view name,
                                      std::span<const std::uint16_t> in_use = {});
  /// Returns null for an id that is not given out.
  const std::string* name_of(std::uint16_t id) const;
  /// Cheap: each datagram of a client may ask for the topics of all messages in its queue.
  std::optional<std::uint16_t> id_of(std::string_view name) const;

  /// Call when the client may have forgotten its ids: each must be registered again.
  void forget_known();
  /// Call when the gateway publishes with this id.
  void touch(std::uint16_t id);

  struct Topic {
    std::string name;
    std::uint16_t id = 0;
    bool is_known = false;   ///< the client has got this id in its present connection (R48, R65)
    bool is_own = false;     ///< the client has asked for this id, or uses it: keeps its meaning
    std::uint64_t used = 0;  ///< later uses have larger numbers
  };
  /// Returns null for an id that is not given out.
  Topic* find(std::uint16_t id);
  const Topic* find(std::uint16_t id) const;
  /// Returns the topics in the order of their ids.
  const std::vector<Topic>& topics() const { return topics_; }
  /// Renames topics under their ids. A name may have several ids afterwards.
  void rename(const NewName& new_name);
  /// Adds a topic from before a restart, or from another gateway. Ignores it if its id is invalid
  /// or taken, or the table is full.
  void restore(Topic topic);
  void clear();

 private:
  std::uint16_t free_id(std::string_view name) const;
  void erase(std::uint16_t id);
  /// Returns the place in by_name_ where `name` is, or belongs.
  std::vector<std::uint16_t>::const_iterator place_of(std::string_view name) const;
  bool may_take(std::size_t octets) const;
  void charge_for(const std::string& name);
  void discharge_for(const std::string& name);
  const Topic* longest_unused(std::span<const std::uint16_t> in_use) const;

  TopicIdOf wanted_id_ = topic_id_of;
  std::vector<Topic> topics_;  // by id
  /// All ids in the order of their names. A map would store each name a second time.
  std::vector<std::uint16_t> by_name_;
  std::uint64_t last_use_ = 0;
  std::size_t octets_ = 0;  // charged
  NameBudget* budget_ = nullptr;
};

}  // namespace slamgw::mqttsn
