// SPDX-License-Identifier: Apache-2.0
// Decides the answer to an HTTP request: one of the page's files, a refusal, or permission for the
// WebSocket or the metrics, which the caller then makes. Pure; the caller reads sockets. Allows GET
// and HEAD only.
#pragma once

#include <span>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "web/server/access.hpp"
#include "web/server/page_files.hpp"

namespace slamgw::web {

struct Request {
  std::string_view method;
  std::string_view target;
  std::string_view host;
  std::string_view origin;
  std::string_view accept_encoding;
  std::string_view if_none_match;
  bool is_upgrade = false;  ///< asks for a WebSocket
};

struct Answer {
  unsigned status = 200;
  std::string_view content_type = "text/plain; charset=utf-8";
  std::string text{};       ///< a text made for this request
  std::string_view file{};  ///< else a file's octets
  std::string_view etag{};
  bool is_gzip = false;
  bool is_web_socket = false;  ///< nothing to send: the upgrade is allowed
  bool is_metrics = false;     ///< `text` is still to be made
};

/// Returns an answer with this status and one line of text.
Answer refuse(unsigned status, std::string why);

/// Header fields of every answer. The page loads nothing from other hosts, may not be in a frame,
/// and does not turn text into markup (Trusted Types).
std::span<const std::pair<std::string_view, std::string_view>> safety_headers();

class Answers {
 public:
  static constexpr std::string_view socket_path = "/api";  // as in Zigbee2MQTT

  explicit Answers(AccessRules access) : access_(std::move(access)) {}

  Answer to(const Request& request) const;

 private:
  Answer file(const Request& request) const;

  AccessRules access_;
};

}  // namespace slamgw::web
