// SPDX-License-Identifier: Apache-2.0
#include "daemon/mqtt/connection_probe.hpp"

#include <fcntl.h>
#include <fmt/format.h>
#include <netdb.h>
#include <openssl/err.h>
#include <openssl/ssl.h>
#include <poll.h>
#include <sys/socket.h>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <memory>
#include <utility>

#include "daemon/core/freed_by.hpp"
#include "daemon/runtime/owned_file.hpp"

namespace slamgw {
namespace {

/// Short, because the daemon's shutdown waits for a running probe.
constexpr int connect_wait_ms = 1000;
constexpr int max_addresses = 2;
constexpr timeval handshake_wait{1, 0};
/// With TLS 1.3, a server may report a missing client certificate only after the handshake.
constexpr timeval afterwards_wait{0, 300000};

using Addresses = std::unique_ptr<addrinfo, FreedBy<freeaddrinfo>>;

/// Returns null, with the reason in `error`, when the name cannot be resolved.
Addresses resolve(const std::string& host, const std::string& port, std::string& error) {
  addrinfo hints{};
  hints.ai_socktype = SOCK_STREAM;
  addrinfo* first = nullptr;
  const int result = getaddrinfo(host.c_str(), port.c_str(), &hints, &first);
  if (result != 0) error = gai_strerror(result);
  return Addresses(result == 0 ? first : nullptr);
}

std::string explain_unknown_name(const BrokerSettings& broker, const std::string& error) {
  return fmt::format(
      "the name '{}' can't be resolved: {}; correct broker.uri, or this host's name service "
      "(getent hosts {})",
      broker.host, error, broker.host);
}

/// Returns 0, or the errno of the failed connection.
int connect_to(const OwnedFile& socket, const addrinfo& address) {
  if (connect(socket.get(), address.ai_addr, address.ai_addrlen) == 0) return 0;
  if (errno != EINPROGRESS) return errno;
  pollfd wait{socket.get(), POLLOUT, 0};
  if (poll(&wait, 1, connect_wait_ms) == 0) return ETIMEDOUT;
  int error = 0;
  socklen_t size = sizeof error;
  getsockopt(socket.get(), SOL_SOCKET, SO_ERROR, &error, &size);
  return error;
}

/// Returns the problem for the operator; empty when the handshake works.
std::string try_tls(int socket, const BrokerSettings& broker) {
  const TlsClient tls(broker);
  if (!tls.problem().empty()) return tls.problem();
  const std::unique_ptr<SSL, FreedBy<SSL_free>> session(SSL_new(tls.context()));
  ERR_clear_error();
  SSL_set_fd(session.get(), socket);
  setsockopt(socket, SOL_SOCKET, SO_RCVTIMEO, &handshake_wait, sizeof handshake_wait);
  if (SSL_connect(session.get()) != 1) {
    std::string problem = tls.certificate_problem();
    return problem.empty() ? explain_handshake_failure(last_tls_error()) : problem;
  }
  setsockopt(socket, SOL_SOCKET, SO_RCVTIMEO, &afterwards_wait, sizeof afterwards_wait);
  char ignored = 0;
  if (SSL_peek(session.get(), &ignored, 1) <= 0 && ERR_peek_error() != 0)
    return explain_tls_end(last_tls_error());
  return {};
}

}  // namespace

Reachability probe_broker(const BrokerSettings& broker) {
  std::string error;
  const Addresses addresses = resolve(broker.host, std::to_string(broker.port), error);
  if (!addresses) return {false, explain_unknown_name(broker, error)};
  int last = 0;
  int tried = 0;
  for (const addrinfo* address = addresses.get(); address && tried < max_addresses;
       address = address->ai_next, ++tried) {
    const OwnedFile socket(
        ::socket(address->ai_family, SOCK_STREAM | SOCK_NONBLOCK | SOCK_CLOEXEC, 0));
    last = connect_to(socket, *address);
    if (last != 0) continue;
    if (!broker.tls) return {true, explain_not_a_broker(broker)};
    const int flags = fcntl(socket.get(), F_GETFL);
    fcntl(socket.get(), F_SETFL, flags & ~O_NONBLOCK);
    const std::string problem = try_tls(socket.get(), broker);
    if (!problem.empty()) return {false, problem};
    return {true, explain_not_a_broker(broker)};
  }
  return {false, explain_no_connection(broker, last)};
}

WayToBroker find_broker(const BrokerSettings& broker) {
  std::string error;
  WayToBroker found;
  const Addresses addresses = resolve(broker.host, "0", error);
  for (const addrinfo* address = addresses.get(); address; address = address->ai_next) {
    char text[NI_MAXHOST];
    if (getnameinfo(address->ai_addr, address->ai_addrlen, text, sizeof text, nullptr, 0,
                    NI_NUMERICHOST) != 0)
      continue;
    if (std::ranges::find(found.addresses, text) == found.addresses.end())
      found.addresses.emplace_back(text);
  }
  if (broker.tls) found.tls = std::make_shared<const TlsClient>(broker);
  if (found.addresses.empty())
    found.problem = explain_unknown_name(broker, error);
  else if (found.tls)
    found.problem = found.tls->problem();
  return found;
}

std::string explain_no_connection(const BrokerSettings& broker, int error) {
  return fmt::format("no connection to {} port {}: {}; does the broker run, and listen there?",
                     broker.host, broker.port, std::strerror(error));
}

std::string explain_not_a_broker(const BrokerSettings& broker) {
  return broker.tls ? "TLS works, but the port does not answer like an MQTT broker"
                    : "the port answers, but not like an MQTT broker";
}

}  // namespace slamgw
