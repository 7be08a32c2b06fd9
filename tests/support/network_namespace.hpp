// SPDX-License-Identifier: Apache-2.0
// Separate networks for I/O tests: a thread enters and leaves them, sockets stay where they were
// created. Requires the right to create namespaces (root, as in CI).
#pragma once

#include <memory>
#include <string>

namespace slamgw::test {

class NetworkNamespace {
 public:
  /// Creates an empty one with loopback up; returns nothing without the right. The calling thread
  /// stays outside.
  static std::unique_ptr<NetworkNamespace> make();
  ~NetworkNamespace();
  NetworkNamespace(const NetworkNamespace&) = delete;
  NetworkNamespace& operator=(const NetworkNamespace&) = delete;

  /// The calling thread is inside while the object exists.
  class Visit {
   public:
    explicit Visit(const NetworkNamespace& where);
    ~Visit();
    Visit(const Visit&) = delete;
    Visit& operator=(const Visit&) = delete;

   private:
    int home_;
  };

  /// `ip ARGUMENTS` inside; throws std::runtime_error when it fails.
  void ip(const std::string& arguments) const;
  /// The path for `ip link set ... netns PATH`.
  std::string path() const;

 private:
  explicit NetworkNamespace(int descriptor) : descriptor_(descriptor) {}

  int descriptor_;
};

}  // namespace slamgw::test
