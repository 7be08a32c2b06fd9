// SPDX-License-Identifier: Apache-2.0
// Who may talk to the page's program: pure checks of the Host and Origin headers.
// A browser sends them truthfully also when a foreign page makes it call, which is what they are
// for: DNS rebinding shows in Host, a foreign page's WebSocket in Origin.
#pragma once

#include <string>
#include <string_view>
#include <vector>

namespace slamgw::web {

class AccessRules {
 public:
  /// `hosts`: names that are right besides addresses and `localhost`, without ports.
  explicit AccessRules(std::vector<std::string> hosts);

  /// `host`: a Host header, `127.0.0.1:8321`, `[::1]:8321`, `localhost`. An address cannot be
  /// rebound, so each is right; of names only the known ones.
  bool is_own_host(std::string_view host) const;
  /// Whether a page that came from `host` sends `origin`. Programs that are no browsers send none,
  /// which is right: what they can do, they can do anyway.
  static bool is_own_origin(std::string_view origin, std::string_view host);

 private:
  std::vector<std::string> hosts_;  ///< lower case
};

}  // namespace slamgw::web
