// SPDX-License-Identifier: Apache-2.0
// The OpenSSL context for one broker: files, the check of certificate and host name, the name in
// the ClientHello. The constructor reads files, so it does not run on the loop.
#pragma once

#include <openssl/ssl.h>

#include <memory>
#include <string>

#include "daemon/core/freed_by.hpp"
#include "daemon/mqtt/settings.hpp"

namespace slamgw {

class TlsClient {
 public:
  explicit TlsClient(const BrokerSettings& broker);
  TlsClient(const TlsClient&) = delete;
  TlsClient& operator=(const TlsClient&) = delete;

  /// Returns why a file can't be used; empty when all can.
  const std::string& problem() const { return problem_; }
  /// Returns the context for SSL_new(). Each session verifies the certificate and the broker's
  /// name, whatever address or name it is connected to. This object must outlive the sessions.
  SSL_CTX* context() const { return context_.get(); }
  /// Returns why a handshake has refused the broker's certificate, for the operator; else empty.
  std::string certificate_problem() const;
  bool has_shaken_hands() const { return has_shaken_hands_; }

 private:
  std::string load_files() const;
  void check_name();
  static int on_verify(int is_good, X509_STORE_CTX* certificates);
  static void on_handshake(const SSL* session, int where, int result);
  static TlsClient& of(const SSL* session);

  const BrokerSettings broker_;
  const std::unique_ptr<SSL_CTX, FreedBy<SSL_CTX_free>> context_;
  bool is_address_ = false;  ///< the host is an address: no name for the ClientHello
  int certificate_error_ = 0;
  bool has_shaken_hands_ = false;
  std::string problem_;
};

/// Takes the newest error of OpenSSL on this thread off its queue and puts it into words.
std::string last_tls_error();
/// Explains a TLS failure that is not the certificate's; `reason` in OpenSSL's words.
std::string explain_handshake_failure(const std::string& reason);
/// Explains that the broker has ended TLS after the handshake; `reason` in OpenSSL's words.
std::string explain_tls_end(const std::string& reason);

}  // namespace slamgw
