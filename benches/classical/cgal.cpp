// Edge-aware upsampling (CGAL): `cgal IN.xyz OUT.xyz POINTS`. Normals by jet fitting on 18 neighbours, oriented by a
// minimum spanning tree; neighbour radius of three average spacings.
#include <CGAL/Simple_cartesian.h>
#include <CGAL/compute_average_spacing.h>
#include <CGAL/edge_aware_upsample_point_set.h>
#include <CGAL/jet_estimate_normals.h>
#include <CGAL/mst_orient_normals.h>

#include <cstdio>
#include <cstdlib>
#include <iterator>
#include <utility>
#include <vector>

using Kernel = CGAL::Simple_cartesian<double>;
using Entry = std::pair<Kernel::Point_3, Kernel::Vector_3>;
using Points = CGAL::First_of_pair_property_map<Entry>;
using Normals = CGAL::Second_of_pair_property_map<Entry>;

int main(int count, char** arguments) {
    if (count != 4) return std::fprintf(stderr, "usage: cgal IN.xyz OUT.xyz POINTS\n"), 64;
    std::vector<Entry> cloud;
    std::FILE* in = std::fopen(arguments[1], "r");
    if (!in) return std::perror(arguments[1]), 1;
    for (double x, y, z; std::fscanf(in, "%lf %lf %lf", &x, &y, &z) == 3;) cloud.push_back({{x, y, z}, {}});
    std::fclose(in);

    const auto maps = CGAL::parameters::point_map(Points()).normal_map(Normals());
    CGAL::jet_estimate_normals<CGAL::Sequential_tag>(cloud, 18, maps);
    cloud.erase(CGAL::mst_orient_normals(cloud, 18, maps), cloud.end());
    const double spacing =
        CGAL::compute_average_spacing<CGAL::Sequential_tag>(cloud, 6, CGAL::parameters::point_map(Points()));
    std::vector<Entry> dense = cloud;
    CGAL::edge_aware_upsample_point_set<CGAL::Sequential_tag>(
        cloud, std::back_inserter(dense),
        CGAL::parameters::point_map(Points()).normal_map(Normals()).sharpness_angle(25).edge_sensitivity(0)
            .neighbor_radius(3 * spacing).number_of_output_points(std::atoi(arguments[3])));

    std::FILE* out = std::fopen(arguments[2], "w");
    if (!out) return std::perror(arguments[2]), 1;
    dense.resize(std::min<std::size_t>(dense.size(), std::atoi(arguments[3])));
    for (const Entry& e : dense) std::fprintf(out, "%.7g %.7g %.7g\n", e.first.x(), e.first.y(), e.first.z());
    return std::fclose(out);
}
