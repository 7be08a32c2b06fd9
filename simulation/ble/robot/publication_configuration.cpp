// SPDX-License-Identifier: Apache-2.0
#include "simulation/ble/robot/publication_configuration.hpp"

namespace slamgw::sim::ble {
namespace {

constexpr std::uint16_t set_op = 0x03;
constexpr std::uint16_t get_op = 0x8018;
constexpr std::uint16_t publication_status_op = 0x8019;
constexpr std::uint16_t set_virtual_op = 0x801a;

constexpr std::size_t published_address_at = 2;
constexpr std::uint8_t max_publication_ttl = 127;

/// Nordic's firmware answers with uninitialised memory when the model does not publish
/// periodically. Hosts must ignore it.
constexpr std::uint8_t undefined_period = 0x5a;

/// Key index and flag, TTL, period, retransmissions.
ModelPublication publication_from(Address address, ByteView fields) {
  const std::uint16_t key_and_credential = get_u16_le(fields, 0);
  return {address,
          static_cast<std::uint16_t>(key_and_credential & 0x0fff),
          (key_and_credential & 1 << 12) != 0,
          fields[2],
          fields[3],
          fields[4]};
}

bool is_periodic(ModelId id) { return id == health_server; }

}  // namespace

std::optional<Answer> PublicationConfiguration::on_message(std::uint16_t opcode,
                                                           ByteView parameters) {
  using Self = PublicationConfiguration;
  static constexpr ConfigRequest<Self> requests[] = {
      {set_op, &Self::set},
      {get_op, &Self::get},
      {set_virtual_op, &Self::set_virtual},
  };
  return answer_request(requests, *this, opcode, parameters);
}

Answer PublicationConfiguration::set(ByteView parameters) {
  const std::optional<ModelId> id = model_id_at(parameters, published_address_at + 2 + 5);
  if (!id) return std::nullopt;
  const Address address = get_u16_le(parameters, published_address_at);
  return set(get_u16_le(parameters, 0),
             publication_from(address, parameters.subspan(published_address_at + 2)), *id);
}

Answer PublicationConfiguration::set_virtual(ByteView parameters) {
  const std::optional<ModelId> id = model_id_at(parameters, published_address_at + sizeof(Key) + 5);
  if (!id) return std::nullopt;
  const Address address = virtual_address(key_at(parameters, published_address_at));
  return set(get_u16_le(parameters, 0),
             publication_from(address, parameters.subspan(published_address_at + sizeof(Key))),
             *id);
}

/// TTLs between 127 and 255 are prohibited (section 4.2.2.6).
Answer PublicationConfiguration::set(Address element, const ModelPublication& publication,
                                     ModelId id) {
  if (publication.ttl > max_publication_ttl && publication.ttl != use_default_ttl) {
    if (firmware_.asserts_on_publication_ttl) failed_assertion_ = "publication TTL above 127";
    return std::nullopt;
  }
  const ConfigStatus result = check(element, publication, id);
  if (result == ConfigStatus::success) {
    ModelPublication& current = configuration_.find_model(id)->publication;
    const bool had_credential = current.has_friendship_credential;
    current = publication;
    if (publication.address == 0) {  // off; only the flag is kept
      current = {};
      current.has_friendship_credential = had_credential;
    }
  }
  return status(result, element, id);
}

ConfigStatus PublicationConfiguration::check(Address element, const ModelPublication& publication,
                                             ModelId id) const {
  const ConfigStatus status = model_status(configuration_, element, id);
  if (status != ConfigStatus::success) return status;
  if (id == configuration_server) return ConfigStatus::invalid_model;
  if (publication.address == 0) return ConfigStatus::success;
  if (configuration_.find_app_key(publication.app_key_index) == nullptr) {
    return ConfigStatus::invalid_app_key_index;
  }
  const bool has_period = publication.period != 0;
  return has_period && !is_periodic(id) ? ConfigStatus::feature_not_supported
                                        : ConfigStatus::success;
}

Answer PublicationConfiguration::get(ByteView parameters) {
  const std::optional<ModelId> id = model_id_at(parameters, 2);
  if (!id) return std::nullopt;
  const Address element = get_u16_le(parameters, 0);
  return status(model_status(configuration_, element, *id), element, *id);
}

/// Returns the publication of the model, or zeros with an error.
Bytes PublicationConfiguration::status(ConfigStatus status, Address element, ModelId id) const {
  ModelPublication publication;
  if (status == ConfigStatus::success) publication = configuration_.find_model(id)->publication;
  if (publication.address != 0 && !is_periodic(id)) publication.period = undefined_period;
  Bytes out = begin_status(publication_status_op, status);
  put_u16_le(out, element);
  put_u16_le(out, publication.address);
  const int credential = publication.has_friendship_credential ? 1 << 12 : 0;
  put_u16_le(out, static_cast<std::uint16_t>(publication.app_key_index | credential));
  put(out, Bytes{publication.ttl, publication.period, publication.retransmit});
  put_model_id(out, id);
  return out;
}

}  // namespace slamgw::sim::ble
