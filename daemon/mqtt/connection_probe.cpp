// SPDX-License-Identifier: Apache-2.0
#include "daemon/mqtt/connection_probe.hpp"

#include <fcntl.h>
#include <fmt/format.h>
#include <netdb.h>
#include <openssl/err.h>
#include <openssl/ssl.h>
#include <openssl/x509_vfy.h>
#include <poll.h>
#include <sys/socket.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <memory>
#include <utility>

namespace slamgw {
namespace {

/// The end of the daemon waits for a probe that runs.
constexpr int connect_wait_ms = 1000;
constexpr int max_addresses = 2;
constexpr timeval handshake_wait{1, 0};
/// A server may say only after the handshake that it wants a certificate (TLS 1.3).
constexpr timeval afterwards_wait{0, 300000};

struct FreeAddresses {
  void operator()(addrinfo* first) const { freeaddrinfo(first); }
};
using Addresses = std::unique_ptr<addrinfo, FreeAddresses>;

/// Null with the reason in `error` when the name is not known.
Addresses resolve(const std::string& host, const std::string& port, std::string& error) {
  addrinfo hints{};
  hints.ai_socktype = SOCK_STREAM;
  addrinfo* first = nullptr;
  const int result = getaddrinfo(host.c_str(), port.c_str(), &hints, &first);
  if (result != 0) error = gai_strerror(result);
  return Addresses(result == 0 ? first : nullptr);
}

class Socket {
 public:
  explicit Socket(int descriptor) : descriptor_(descriptor) {}
  Socket(Socket&& other) noexcept : descriptor_(std::exchange(other.descriptor_, -1)) {}
  ~Socket() {
    if (descriptor_ >= 0) close(descriptor_);
  }
  int get() const { return descriptor_; }

 private:
  int descriptor_;
};

/// 0, or the error that connecting ended with.
int connect_to(const Socket& socket, const addrinfo& address) {
  if (connect(socket.get(), address.ai_addr, address.ai_addrlen) == 0) return 0;
  if (errno != EINPROGRESS) return errno;
  pollfd wait{socket.get(), POLLOUT, 0};
  if (poll(&wait, 1, connect_wait_ms) == 0) return ETIMEDOUT;
  int error = 0;
  socklen_t size = sizeof error;
  getsockopt(socket.get(), SOL_SOCKET, SO_ERROR, &error, &size);
  return error;
}

template <class Type, void (*release)(Type*)>
struct Release {
  void operator()(Type* what) const { release(what); }
};
using Context = std::unique_ptr<SSL_CTX, Release<SSL_CTX, SSL_CTX_free>>;
using Session = std::unique_ptr<SSL, Release<SSL, SSL_free>>;

std::string last_tls_error() {
  const char* reason = ERR_reason_error_string(ERR_peek_last_error());
  ERR_clear_error();
  return reason ? reason : "the broker closed the connection";
}

/// Empty when all files are usable.
std::string load_files(SSL_CTX* context, const BrokerSettings& broker) {
  const auto fails = [](const char* key, const std::string& file) {
    return fmt::format("{}: {} can't be used: {}", key, file, last_tls_error());
  };
  if (!broker.ca_file) {
    SSL_CTX_set_default_verify_paths(context);
  } else if (SSL_CTX_load_verify_locations(context, broker.ca_file->c_str(), nullptr) != 1) {
    return fails("broker.tls.ca_file", *broker.ca_file);
  }
  if (broker.certificate_file &&
      SSL_CTX_use_certificate_chain_file(context, broker.certificate_file->c_str()) != 1)
    return fails("broker.tls.certificate_file", *broker.certificate_file);
  if (broker.key_file &&
      SSL_CTX_use_PrivateKey_file(context, broker.key_file->c_str(), SSL_FILETYPE_PEM) != 1)
    return fails("broker.tls.key_file", *broker.key_file);
  return {};
}

std::string explain_certificate(long result, const BrokerSettings& broker) {
  const std::string what = X509_verify_cert_error_string(result);
  switch (result) {
    case X509_V_ERR_HOSTNAME_MISMATCH:
    case X509_V_ERR_IP_ADDRESS_MISMATCH:
      return fmt::format(
          "the broker's certificate is not for '{}' ({}): broker.uri must use a name "
          "that is in the certificate",
          broker.host, what);
    case X509_V_ERR_CERT_HAS_EXPIRED:
    case X509_V_ERR_CERT_NOT_YET_VALID:
      return fmt::format(
          "the broker's certificate is not valid now ({}): renew it, or set this "
          "host's clock",
          what);
    default:
      return fmt::format(
          "the broker's certificate is not trusted ({}): broker.tls.ca_file must name "
          "the CA that signed it",
          what);
  }
}

/// Empty when the handshake works.
std::string try_tls(int socket, const BrokerSettings& broker) {
  const Context context(SSL_CTX_new(TLS_client_method()));
  if (std::string problem = load_files(context.get(), broker); !problem.empty()) return problem;
  SSL_CTX_set_verify(context.get(), SSL_VERIFY_PEER, nullptr);
  SSL_CTX_set_min_proto_version(context.get(), TLS1_2_VERSION);
  const Session session(SSL_new(context.get()));
  X509_VERIFY_PARAM* check = SSL_get0_param(session.get());
  if (X509_VERIFY_PARAM_set1_ip_asc(check, broker.host.c_str()) != 1) {
    SSL_set1_host(session.get(), broker.host.c_str());
    // The macro for this casts in the old style. OpenSSL copies the name.
    SSL_ctrl(session.get(), SSL_CTRL_SET_TLSEXT_HOSTNAME, TLSEXT_NAMETYPE_host_name,
             const_cast<char*>(broker.host.c_str()));
  }
  ERR_clear_error();
  SSL_set_fd(session.get(), socket);
  setsockopt(socket, SOL_SOCKET, SO_RCVTIMEO, &handshake_wait, sizeof handshake_wait);
  if (SSL_connect(session.get()) != 1) {
    const long result = SSL_get_verify_result(session.get());
    if (result != X509_V_OK) return explain_certificate(result, broker);
    return fmt::format("TLS fails: {}; is this the broker's TLS port?", last_tls_error());
  }
  setsockopt(socket, SOL_SOCKET, SO_RCVTIMEO, &afterwards_wait, sizeof afterwards_wait);
  char ignored = 0;
  if (SSL_peek(session.get(), &ignored, 1) <= 0 && ERR_peek_error() != 0) {
    return fmt::format(
        "the broker ends TLS: {}; does it want a client certificate "
        "(broker.tls.certificate_file, broker.tls.key_file)?",
        last_tls_error());
  }
  return {};
}

}  // namespace

Reachability probe_broker(const BrokerSettings& broker) {
  std::string error;
  const Addresses addresses = resolve(broker.host, std::to_string(broker.port), error);
  if (!addresses)
    return {false,
            fmt::format("the name '{}' can't be resolved: {}; correct broker.uri, or this host's "
                        "name service (getent hosts {})",
                        broker.host, error, broker.host)};
  int last = 0;
  int tried = 0;
  for (const addrinfo* address = addresses.get(); address && tried < max_addresses;
       address = address->ai_next, ++tried) {
    const Socket socket(
        ::socket(address->ai_family, SOCK_STREAM | SOCK_NONBLOCK | SOCK_CLOEXEC, 0));
    last = connect_to(socket, *address);
    if (last != 0) continue;
    if (!broker.tls) return {true, "the port answers, but not as an MQTT broker does"};
    const int flags = fcntl(socket.get(), F_GETFL);
    fcntl(socket.get(), F_SETFL, flags & ~O_NONBLOCK);
    const std::string problem = try_tls(socket.get(), broker);
    if (!problem.empty()) return {false, problem};
    return {true, "TLS works, but the port does not answer as an MQTT broker does"};
  }
  return {false,
          fmt::format("no connection to {} port {}: {}; does the broker run, and listen there?",
                      broker.host, broker.port, std::strerror(last))};
}

std::vector<std::string> resolve_host(const std::string& host) {
  std::string ignored;
  const Addresses addresses = resolve(host, "0", ignored);
  std::vector<std::string> literals;
  for (const addrinfo* address = addresses.get(); address; address = address->ai_next) {
    char text[NI_MAXHOST];
    if (getnameinfo(address->ai_addr, address->ai_addrlen, text, sizeof text, nullptr, 0,
                    NI_NUMERICHOST) != 0)
      continue;
    if (std::find(literals.begin(), literals.end(), text) == literals.end())
      literals.emplace_back(text);
  }
  return literals;
}

}  // namespace slamgw
