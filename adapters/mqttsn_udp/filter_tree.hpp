// SPDX-License-Identifier: Apache-2.0
// Who subscribed to what, as a tree of topic levels: the cost of a message grows with the levels of
// its topic and with who gets it, never with all clients.
#pragma once

#include <map>
#include <memory>
#include <string>
#include <string_view>
#include <vector>

#include "adapters/mqttsn_udp/client_session.hpp"

namespace slamgw::mqttsn {

class FilterTree {
 public:
  /// One subscription that matches; `subscription` lives in `session`.
  struct Match {
    ClientSession* session = nullptr;
    Subscription* subscription = nullptr;
  };
  struct Matches {
    std::vector<Match> all;
    std::size_t filters = 0;  ///< different filters among them
  };

  /// `filter` is valid; a session has a filter at most once.
  void add(std::string_view filter, const Match& subscriber);
  /// True when nobody has this filter any more.
  bool remove(std::string_view filter, const ClientSession& session);
  /// MQTT matching, including `$...` (MQTT 3.1.1 section 4.7).
  Matches match(std::string_view topic) const;

 private:
  struct Node {
    std::map<std::string, std::unique_ptr<Node>, std::less<>> children;
    std::vector<Match> subscribers;
    bool is_empty() const { return children.empty() && subscribers.empty(); }
  };
  static bool remove_below(Node& node, std::string_view filter, const ClientSession& session);
  static void match_below(const Node& node, std::string_view topic, bool is_first, Matches& found);
  static void collect(const Node& node, Matches& found);
  static const Node* child(const Node& node, std::string_view level);

  Node root_;
};

}  // namespace slamgw::mqttsn
