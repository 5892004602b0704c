// Kokkos views as arrays of globule: in place where the memory has the right order, else through one buffer that stays.
#pragma once
#include <globule/globule.hpp>

#include <Kokkos_Core.hpp>
#include <optional>
#include <type_traits>

namespace globule::adaptors {

/// A view of float or double, (N, 3) or (N,), of any layout, in host memory or that of a GPU.
template <class Memory = Kokkos::HostSpace> class KokkosArray {
public:
    /// The array of a view, which must stay as Scene::update says; so must this object.
    template <class View> ArrayView operator()(const View& view) {
        using T = std::remove_const_t<typename View::value_type>;
        constexpr bool host = Kokkos::SpaceAccessibility<Kokkos::HostSpace, typename View::memory_space>::accessible;
        static_assert(View::rank == 1 || View::rank == 2, "expected a view (N,) or (N, K)");
        static_assert(std::is_same_v<T, float> || std::is_same_v<T, double>, "expected a view of float or double");
        static_assert(std::is_same_v<Memory, typename View::memory_space>, "expected KokkosArray<View::memory_space>");
        constexpr Location where{.device = host ? Location::host : Location::some_gpu};
        typename View::execution_space().fence();  // what writes the view has ended
        const std::size_t n = view.extent(0), columns = View::rank == 2 ? view.extent(1) : 1;
        const bool rows = View::rank == 1 ? view.span_is_contiguous()
                                          : std::is_same_v<typename View::array_layout, Kokkos::LayoutRight> &&
                                                view.span_is_contiguous();
        in_place_ = rows && (host || std::is_same_v<T, float>);  // a GPU's arrays are float32
        if (in_place_) return {view.data(), shape(n, columns, View::rank), where};
        if (!buffer_ || buffer_->extent(0) != n || buffer_->extent(1) != columns)
            buffer_.emplace(Kokkos::view_alloc(Kokkos::WithoutInitializing, "globule"), n, columns);
        fill(view, *buffer_, n, columns);
        return {buffer_->data(), shape(n, columns, View::rank), where};
    }

    /// Whether the last array is the view's own memory.
    bool in_place() const { return in_place_; }

    using Buffer = Kokkos::View<float**, Kokkos::LayoutRight, Memory>;

    /// Rows in order, as float32.
    template <class View> static void fill(const View& view, const Buffer& out, std::size_t n, std::size_t columns) {
        using Space = typename View::execution_space;
        Kokkos::parallel_for(
            "globule", Kokkos::RangePolicy<Space>(0, n), KOKKOS_LAMBDA(const std::size_t i) {
                for (std::size_t k = 0; k < columns; ++k)
                    if constexpr (View::rank == 2) out(i, k) = float(view(i, k));
                    else out(i, k) = float(view(i));
            });
        Space().fence();
    }

private:
    static Shape shape(std::size_t n, std::size_t columns, int rank) {
        return rank == 2 ? Shape(n, columns) : Shape(n);
    }

    std::optional<Buffer> buffer_{};
    bool in_place_ = false;
};

}  // namespace globule::adaptors
