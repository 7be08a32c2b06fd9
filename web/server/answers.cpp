// SPDX-License-Identifier: Apache-2.0
#include "web/server/answers.hpp"

#include <array>

namespace slamgw::web {

Answer refuse(unsigned status, std::string why) {
  Answer answer;
  answer.status = status;
  answer.text = std::move(why) + "\n";
  return answer;
}

std::span<const std::pair<std::string_view, std::string_view>> safety_headers() {
  static constexpr auto headers = std::to_array<std::pair<std::string_view, std::string_view>>({
      {"Content-Security-Policy",
       "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self'; connect-src "
       "'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'; "
       "require-trusted-types-for 'script'; trusted-types 'none'"},
      {"X-Content-Type-Options", "nosniff"},
      {"X-Frame-Options", "DENY"},
      {"Referrer-Policy", "no-referrer"},
      {"Cross-Origin-Opener-Policy", "same-origin"},
      {"Cross-Origin-Resource-Policy", "same-origin"},
      {"Permissions-Policy", "camera=(), geolocation=(), microphone=()"},
  });
  return headers;
}

Answer Answers::to(const Request& request) const {
  if (!access_.is_own_host(request.host))
    return refuse(403,
                  "This page is not known by that name. Use its address, or add the name to "
                  "web.hosts in gateway.json.");
  if (!AccessRules::is_own_origin(request.origin, request.host))
    return refuse(403, "Another page asked for this (its Origin is not this host).");
  const std::string_view path = request.target.substr(0, request.target.find('?'));
  if (request.method != "GET" && request.method != "HEAD")
    return refuse(405, "Only GET and HEAD are allowed.");
  if (path == socket_path) {
    if (!request.is_upgrade) return refuse(426, "This is a WebSocket.");
    Answer answer;
    answer.is_web_socket = true;
    return answer;
  }
  if (path == "/metrics") {
    Answer answer;
    answer.content_type = "text/plain; version=0.0.4; charset=utf-8";
    answer.is_metrics = true;
    return answer;
  }
  return file(request);
}

Answer Answers::file(const Request& request) const {
  const std::string_view path = request.target.substr(0, request.target.find('?'));
  for (const PageFile& file : page_files()) {
    if (file.path != path) continue;
    Answer answer;
    answer.content_type = file.content_type;
    answer.etag = file.etag;
    answer.is_gzip = request.accept_encoding.find("gzip") != std::string_view::npos;
    const bool is_known = request.if_none_match == file.etag;
    if (is_known) answer.status = 304;
    if (!is_known) answer.file = answer.is_gzip ? file.gzip : file.text;
    return answer;
  }
  return refuse(404, "There is no such page.");
}

}  // namespace slamgw::web
