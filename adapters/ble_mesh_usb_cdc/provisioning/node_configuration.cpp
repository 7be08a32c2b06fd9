// SPDX-License-Identifier: Apache-2.0
#include "adapters/ble_mesh_usb_cdc/provisioning/node_configuration.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <iterator>
#include <utility>

#include "adapters/ble_mesh_usb_cdc/nordic/commands.hpp"

namespace slamgw::ble {

NodeConfiguration::NodeConfiguration(const Node& node, Purpose purpose,
                                     ConfigurationSettings settings, std::uint16_t subnet_handle)
    : purpose_(purpose),
      settings_(std::move(settings)),
      address_(node.address),
      device_key_(node.device_key),
      subnet_handle_(subnet_handle) {
  steps_.push_back(purpose == Purpose::reset ? node_reset_step() : composition_step());
}

std::optional<Bytes> NodeConfiguration::command() const {
  if (stage_ == Stage::adding_key) return encode_devkey_add(address_, subnet_handle_, device_key_);
  if (stage_ == Stage::deleting_key)
    return encode_command(CommandOpcode::devkey_delete, devkey_handle_);
  return std::nullopt;
}

void NodeConfiguration::on_command_ended(const CommandEnded& ended, TimePoint now) {
  if (stage_ == Stage::deleting_key) {
    stage_ = Stage::ended;
    is_key_table_unclear_ = ended.status != Status::success && !ended.is_repeat;
    return;
  }
  if (stage_ != Stage::adding_key) return;
  ByteReader data(ended.data);
  devkey_handle_ = data.read_u16_le();
  if (ended.status == Status::success && data.ok()) {
    stage_ = Stage::talking;
    return begin_step(now);
  }
  is_key_table_unclear_ = true;
  finish(State::failed, fmt::format("the serial board does not take its device key ({})",
                                    to_string(ended.status)));
  stage_ = Stage::ended;
}

void NodeConfiguration::begin_step(TimePoint now) {
  step_since_ = now;
  send_at_ = now;
  pause_ = segments_of(steps_.front().request.size()) > 1 ? 2 * first_pause : first_pause;
  last_refusal_.clear();
}

std::optional<Bytes> NodeConfiguration::take_message(TimePoint now) {
  if (stage_ != Stage::talking || now < send_at_) return std::nullopt;
  send_at_ = now + pause_;
  pause_ *= 2;
  return steps_.front().request;
}

bool NodeConfiguration::on_message(const MessageReceived& message, TimePoint now) {
  if (stage_ != Stage::talking || message.source != address_ ||
      message.appkey_handle != devkey_handle_)
    return false;
  const auto access = decode_access(message.payload);
  if (!access.has_value()) return false;
  if (steps_.front().is_answered_by(*access)) on_answer(*access, now);
  return true;  // another one is a late answer to an earlier request
}

void NodeConfiguration::on_answer(const AccessMessage& message, TimePoint now) {
  const ConfigurationStep step = std::move(steps_.front());
  steps_.pop_front();
  const std::uint8_t status = step.has_status ? message.params.front() : std::uint8_t{0};
  if (status != 0 && status != step.also_done) {
    const std::string refusal =
        fmt::format("{} was refused: {} (0x{:02x})", step.what, config_status_text(status), status);
    if (step.is_required) return finish(State::failed, refusal);
    problem_ += (problem_.empty() ? "" : "; ") + refusal;
  }
  if (step.answer == composition_data_status) {
    const auto composition = decode_composition(message.params);
    if (!composition.has_value())
      return finish(State::failed, "its composition data can't be read");
    for (auto& next : purpose_ == Purpose::move
                          ? plan_publications(settings_, address_, *composition)
                          : plan_configuration(settings_, address_, *composition))
      steps_.push_back(std::move(next));
  }
  if (step.lists_groups_of && status == 0) {
    auto groups =
        plan_groups(settings_, *step.lists_groups_of,
                    decode_subscription_list(message.params, step.lists_groups_of->model));
    steps_.insert(steps_.begin(), std::move_iterator(groups.begin()),
                  std::move_iterator(groups.end()));
  }
  if (steps_.empty()) return finish(State::succeeded, std::exchange(problem_, {}));
  begin_step(now);
}

void NodeConfiguration::on_send_refused(const std::string& why, TimePoint now) {
  if (stage_ != Stage::talking) return;
  last_refusal_ = why;
  pause_ = std::max(first_pause, pause_ / 2);  // nothing was sent
  send_at_ = now + refused_pause;
}

std::optional<TimePoint> NodeConfiguration::deadline() const {
  if (stage_ != Stage::talking) return std::nullopt;
  return std::min(send_at_, step_since_ + step_time_limit);
}

void NodeConfiguration::on_deadline(TimePoint now) {
  if (stage_ != Stage::talking || now < step_since_ + step_time_limit) return;
  std::string why =
      fmt::format("no answer to {} in {} s", steps_.front().what,
                  std::chrono::duration_cast<std::chrono::seconds>(step_time_limit).count());
  if (!last_refusal_.empty()) why += " (" + last_refusal_ + ")";
  finish(State::failed, std::move(why));
}

void NodeConfiguration::finish(State result, std::string problem) {
  result_ = result;
  problem_ = std::move(problem);
  stage_ = Stage::deleting_key;
}

}  // namespace slamgw::ble
