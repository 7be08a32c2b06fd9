// SPDX-License-Identifier: Apache-2.0
// The daemon's answers as text for people: at most 80 columns, colour only where asked for. Pure;
// what is missing in an answer is left out, what could move the cursor is made harmless.
#pragma once

#include <chrono>
#include <nlohmann/json.hpp>
#include <string>
#include <string_view>

namespace slamgw::ctl {

/// Text ends with a line end.
class Show {
 public:
  Show(bool with_colour, std::chrono::system_clock::time_point now)
      : with_colour_(with_colour), now_(now) {}

  std::string status(const nlohmann::json& status) const;
  std::string robots(const nlohmann::json& robots) const;
  std::string fleet(const nlohmann::json& fleet) const;
  std::string event(const nlohmann::json& event) const;
  std::string outcome(const nlohmann::json& outcome) const;
  /// Devices that no mesh has.
  std::string devices(const nlohmann::json& devices) const;
  /// Robots of the BLE mesh.
  std::string nodes(const nlohmann::json& nodes) const;
  /// What became of a robot that was put out of the mesh.
  std::string removed(const nlohmann::json& node) const;
  std::string exported_mesh(const nlohmann::json& exported) const;
  /// How long new robots may join, and what one of them has come to.
  std::string joining_head(const nlohmann::json& news) const;
  std::string joining(const nlohmann::json& event) const;
  /// Messages that were set aside: the head of the table, and a page of it.
  std::string dead_letters_head(const nlohmann::json& first_page) const;
  std::string dead_letters(const nlohmann::json& letters) const;
  std::string resent(const nlohmann::json& done) const;
  /// What an order came to: its members in words.
  std::string done(const nlohmann::json& done) const;

 private:
  /// Green for what is well, red for what is not, yellow between.
  std::string paint(std::string_view state, std::string text) const;
  std::string mesh_line(std::string name, const nlohmann::json& mesh) const;

  bool with_colour_;
  std::chrono::system_clock::time_point now_;
};

}  // namespace slamgw::ctl
