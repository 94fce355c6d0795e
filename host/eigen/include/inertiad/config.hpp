// SPDX-License-Identifier: Apache-2.0
/// The robot's configuration, read from what `inertiactl compile` wrote.
#pragma once

#include "types.hpp"

#include <stdexcept>
#include <string>

extern "C" {
#include "config.h"
#include "config_file.h"
}

namespace inertiad {

/// A checked ipe_config_t. Throws std::invalid_argument with the core's message where it is refused.
class Config {
public:
    /// From the bytes of robot.cfg.
    static Config from_bytes(const void* data, std::size_t size)
    {
        Config config;
        char message[256] = "";
        if (ipe_config_from_bytes(static_cast<const uint8_t*>(data), size, &config.c_, message, sizeof message) !=
            IPE_OK) {
            throw std::invalid_argument(message);
        }
        return config;
    }

    /// From the file robot.cfg.
    static Config load(const std::string& path)
    {
        Config config;
        char message[512] = "";
        if (ipe_config_load(path.c_str(), &config.c_, message, sizeof message) != IPE_OK) {
            throw std::invalid_argument(message);
        }
        return config;
    }

    /// A copy of a C configuration, checked.
    static Config from(const ipe_config_t& c)
    {
        Config config;
        char message[256] = "";
        if (ipe_config_check(&c, message, sizeof message) != IPE_OK) { throw std::invalid_argument(message); }
        config.c_ = c;
        return config;
    }

    const ipe_config_t& c() const noexcept { return c_; }
    int n_cables() const noexcept { return c_.n_cables; }

private:
    Config() = default;
    ipe_config_t c_{};
};

}  // namespace inertiad
