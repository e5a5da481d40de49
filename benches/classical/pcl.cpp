// Moving least squares upsampling (PCL): `pcl IN.xyz OUT.xyz POINTS`. Quadratic surfaces within 2.5 spacings, sampled on
// a disk around each point so finely that about twice as many points come out; the first POINTS of a random order stay.
// (PCL has no fast sampling to a count that is even; `densecloud` is not used for it, so that times are PCL's own.)
#include <pcl/point_types.h>
#include <pcl/search/kdtree.h>
#include <pcl/surface/mls.h>

#include <algorithm>
#include <cstdio>
#include <cstdlib>
#include <random>

int main(int count, char** arguments) {
    if (count != 4) return std::fprintf(stderr, "usage: pcl IN.xyz OUT.xyz POINTS\n"), 64;
    using Cloud = pcl::PointCloud<pcl::PointXYZ>;
    Cloud::Ptr cloud(new Cloud);
    std::FILE* in = std::fopen(arguments[1], "r");
    if (!in) return std::perror(arguments[1]), 1;
    for (float x, y, z; std::fscanf(in, "%f %f %f", &x, &y, &z) == 3;) cloud->push_back({x, y, z});
    std::fclose(in);

    pcl::search::KdTree<pcl::PointXYZ>::Ptr tree(new pcl::search::KdTree<pcl::PointXYZ>);
    tree->setInputCloud(cloud);
    double spacing = 0;
    for (const auto& point : *cloud) {
        pcl::Indices indices;
        std::vector<float> squared;
        tree->nearestKSearch(point, 7, indices, squared);
        for (int k = 1; k < 7; ++k) spacing += std::sqrt(squared[k]) / 6;
    }
    spacing /= cloud->size();

    const std::size_t wanted = std::atoi(arguments[3]);
    pcl::MovingLeastSquares<pcl::PointXYZ, pcl::PointXYZ> mls;
    mls.setInputCloud(cloud);
    mls.setSearchMethod(tree);
    mls.setPolynomialOrder(2);
    mls.setSearchRadius(2.5 * spacing);
    mls.setUpsamplingMethod(decltype(mls)::SAMPLE_LOCAL_PLANE);
    mls.setUpsamplingRadius(0.6 * spacing);
    // A disk of that radius sampled at this step holds about twice the ratio.
    mls.setUpsamplingStepSize(0.6 * spacing * std::sqrt(3.14159 / (2.0 * wanted / cloud->size())));
    Cloud dense;
    mls.process(dense);
    std::shuffle(dense.begin(), dense.end(), std::mt19937(0));
    if (dense.size() < wanted) return std::fprintf(stderr, "only %zu points came out\n", dense.size()), 1;

    std::FILE* out = std::fopen(arguments[2], "w");
    if (!out) return std::perror(arguments[2]), 1;
    for (std::size_t i = 0; i < wanted; ++i) {
        std::fprintf(out, "%.7g %.7g %.7g\n", dense[i].x, dense[i].y, dense[i].z);
    }
    return std::fclose(out);
}
