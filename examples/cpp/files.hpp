// The few file formats that the examples read and write.
#pragma once
#include <cstdint>
#include <cstdio>
#include <cstring>
#include <fstream>
#include <sstream>
#include <stdexcept>
#include <string>
#include <vector>

/// An image as PPM: any viewer shows it.  rgb: (height, width, 3).
inline void write_ppm(const std::string& path, const std::vector<std::uint8_t>& rgb, int width, int height) {
    std::ofstream file(path, std::ios::binary);
    file << "P6\n" << width << ' ' << height << "\n255\n";
    file.write(reinterpret_cast<const char*>(rgb.data()), std::streamsize(rgb.size()));
    if (!file.flush()) throw std::runtime_error(path + ": cannot be written");
}

/// Numbers as they are in memory.
template <class T> void write_raw(const std::string& path, const T* data, std::size_t n) {
    std::ofstream file(path, std::ios::binary);
    file.write(reinterpret_cast<const char*>(data), std::streamsize(n * sizeof(T)));
    if (!file.flush()) throw std::runtime_error(path + ": cannot be written");
}

/// Positions (N, 3), flat: .npy (float32 or float64, (N, 3)), .raw or .bin (float32), else text with three numbers
/// first on a line.
inline std::vector<float> read_positions(const std::string& path) {
    std::ifstream file(path, std::ios::binary);
    std::stringstream whole;
    whole << file.rdbuf();
    if (!file) throw std::runtime_error(path + ": cannot be read");
    const std::string bytes = whole.str();
    const auto ends_with = [&](const char* ending) {
        return path.size() > std::strlen(ending) && path.ends_with(ending);
    };
    std::vector<float> positions;
    if (ends_with(".npy")) {
        if (bytes.size() < 12 || bytes.compare(0, 6, "\x93NUMPY") != 0)
            throw std::runtime_error(path + ": expected a .npy file");
        const auto byte = [&](std::size_t i) { return std::size_t(std::uint8_t(bytes[i])); };
        const bool first = bytes[6] == 1;
        const std::size_t begin = first ? 10 : 12,
                          length =
                              first ? byte(8) | byte(9) << 8 : byte(8) | byte(9) << 8 | byte(10) << 16 | byte(11) << 24;
        if (begin + length > bytes.size()) throw std::runtime_error(path + ": the file breaks off");
        const std::string header = bytes.substr(begin, length);
        const bool single = header.find("'<f4'") != std::string::npos;
        if ((!single && header.find("'<f8'") == std::string::npos) || header.find(", 3)") == std::string::npos ||
            header.find("True") != std::string::npos)
            throw std::runtime_error(path + ": expected float32 or float64 of shape (N, 3), got " + header);
        const char* data = bytes.data() + begin + length;
        const std::size_t n = (bytes.size() - begin - length) / (single ? 4 : 8);
        for (std::size_t i = 0; i < n; ++i) {
            float f;
            double d;
            std::memcpy(single ? static_cast<void*>(&f) : &d, data + i * (single ? 4 : 8), single ? 4 : 8);
            positions.push_back(single ? f : float(d));
        }
    } else if (ends_with(".raw") || ends_with(".bin")) {
        positions.resize(bytes.size() / sizeof(float));
        std::memcpy(positions.data(), bytes.data(), positions.size() * sizeof(float));
    } else {
        std::istringstream lines(bytes);
        for (std::string line; std::getline(lines, line);) {
            float x, y, z;
            if (std::sscanf(line.c_str(), "%f%*[ ,\t]%f%*[ ,\t]%f", &x, &y, &z) == 3)
                positions.insert(positions.end(), {x, y, z});
        }
    }
    positions.resize(positions.size() / 3 * 3);
    return positions;
}
