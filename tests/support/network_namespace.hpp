// SPDX-License-Identifier: Apache-2.0
// Networks of our own for I/O tests: a thread moves in and out of them, sockets stay where they
// were made. Needs the right to make namespaces (root, as in CI).
#pragma once

#include <memory>
#include <string>

namespace slamgw::test {

class NetworkNamespace {
 public:
  /// A new, empty one with loopback up; nothing when we may not. The calling thread stays where it
  /// is.
  static std::unique_ptr<NetworkNamespace> make();
  ~NetworkNamespace();
  NetworkNamespace(const NetworkNamespace&) = delete;
  NetworkNamespace& operator=(const NetworkNamespace&) = delete;

  /// The calling thread is inside for the life of the object.
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
  /// For `ip link set ... netns PATH`.
  std::string path() const;

 private:
  explicit NetworkNamespace(int descriptor) : descriptor_(descriptor) {}

  int descriptor_;
};

}  // namespace slamgw::test
