// The adaptor for Kokkos on views of both layouts and types in host memory.
#include "drop.hpp"
#include "kokkos.hpp"

namespace {

template <class View> void draw_drop(const std::string& name) {
    const auto places = drop();
    View view("positions", places.size());
    Kokkos::View<double*, Kokkos::HostSpace> speed("speed", places.size());
    for (std::size_t i = 0; i < places.size(); ++i) {
        for (std::size_t k = 0; k < 3; ++k) view(i, k) = typename View::value_type(places[i][k]);
        speed(i) = double(i) / double(places.size());
    }
    globule::adaptors::KokkosArray<> positions, weights;
    globule::Scene scene({.surface = globule::Surface::smooth, .spacing = kSpacing, .device = "cpu"});
    scene.update({.positions = positions(view)});
    const float* first = static_cast<const float*>(weights(Kokkos::subview(speed, Kokkos::ALL)).data());
    if (static_cast<const void*>(first) != speed.data()) std::printf("a contiguous view was copied\n");
    std::vector<float> values(places.size());
    for (std::size_t i = 0; i < values.size(); ++i) values[i] = float(speed(i));
    draw(name, scene, values, positions.in_place());
}

}  // namespace

int main(int n_arguments, char** arguments) {
    Kokkos::ScopeGuard guard(n_arguments, arguments);
    try {
        draw_drop<Kokkos::View<float* [3], Kokkos::LayoutRight, Kokkos::HostSpace>>("kokkos_right");
        draw_drop<Kokkos::View<double* [3], Kokkos::LayoutRight, Kokkos::HostSpace>>("kokkos_double");
        draw_drop<Kokkos::View<float* [3], Kokkos::LayoutLeft, Kokkos::HostSpace>>("kokkos_left");
        draw_drop<Kokkos::View<double* [3], Kokkos::LayoutLeft, Kokkos::HostSpace>>("kokkos_left_double");
    } catch (const globule::Error& e) {
        std::fprintf(stderr, "%s\n", e.what());
        return 1;
    }
}
