// SPDX-License-Identifier: Apache-2.0
// Errors as values for everything that comes from outside (ARCHITECTURE.md, "Errors").
#pragma once

#include <boost/system/result.hpp>
#include <cstdlib>

namespace slamgw {

/// A value or the reason why there is none. Use `operator*` after `has_value()`, never `value()`.
template <class T, class E>
using Result = boost::system::result<T, E>;

/// Visitor for std::visit made of lambdas.
template <class... F>
struct overloaded : F... {
  using F::operator()...;
};
template <class... F>
overloaded(F...) -> overloaded<F...>;

}  // namespace slamgw
