// SPDX-License-Identifier: Apache-2.0
// A deleter of std::unique_ptr for objects of C libraries: `FreedBy<BIO_free>`.
#pragma once

namespace slamgw {

template <auto function>
struct FreedBy {
  template <class T>
  void operator()(T* object) const {
    function(object);
  }
};

}  // namespace slamgw
