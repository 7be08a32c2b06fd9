// SPDX-License-Identifier: Apache-2.0
// Decides who may talk to the page's program: pure checks of the Host and Origin headers. Browsers
// send them truthfully even for a foreign page: DNS rebinding shows in Host, a foreign page's
// WebSocket in Origin.
#pragma once

#include <string>
#include <string_view>
#include <vector>

namespace slamgw::web {

class AccessRules {
 public:
  /// `hosts`: allowed names besides addresses and `localhost`, without ports.
  explicit AccessRules(std::vector<std::string> hosts);

  /// `host`: a Host header, `127.0.0.1:8321`, `[::1]:8321`, `localhost`. Every address is allowed,
  /// because it cannot be rebound; of the names, only the known ones.
  bool is_own_host(std::string_view host) const;
  /// Returns whether a page that came from `host` sends `origin`. A missing origin is allowed:
  /// programs other than browsers send none, and could send any.
  static bool is_own_origin(std::string_view origin, std::string_view host);

 private:
  std::vector<std::string> hosts_;  ///< lower case
};

}  // namespace slamgw::web
