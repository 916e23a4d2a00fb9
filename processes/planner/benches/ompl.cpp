// OMPL's planners on forests that are read from the standard input: time to the first path and lengths after given times.
//
// In: per forest "forest fx fy fz tx ty tz  lx ly lz mx my mz  n" and n lines "x y r", upright cylinders without end; a motion is checked
// exactly, at once, as benches/ompl.rs does it. Out: per planner and forest "name first_ms" and two lengths for every time of the
// command line, ms: of the path, and of the path after OMPL's shortcuts, which take time that is not counted. "inf": no path yet.
#include <ompl/base/MotionValidator.h>
#include <ompl/base/objectives/PathLengthOptimizationObjective.h>
#include <ompl/base/spaces/RealVectorStateSpace.h>
#include <ompl/geometric/PathSimplifier.h>
#include <ompl/geometric/SimpleSetup.h>
#include <ompl/geometric/planners/informedtrees/ABITstar.h>
#include <ompl/geometric/planners/informedtrees/BITstar.h>
#include <ompl/geometric/planners/rrt/InformedRRTstar.h>
#include <ompl/geometric/planners/rrt/RRTConnect.h>
#include <ompl/util/Console.h>
#include <ompl/util/RandomNumbers.h>
#include <algorithm>
#include <chrono>
#include <cmath>
#include <iostream>
#include <limits>
#include <memory>
#include <string>
#include <vector>

namespace ob = ompl::base;
namespace og = ompl::geometric;
using Clock = std::chrono::steady_clock;

struct Pole { double x, y, r; };
struct Forest { double from[3], to[3], least[3], most[3]; std::vector<Pole> poles; };

static const double *at(const ob::State *state) { return state->as<ob::RealVectorStateSpace::StateType>()->values; }

static bool clear(const Forest &forest, const double *a, const double *b) {
    const double wx = b[0] - a[0], wy = b[1] - a[1], length2 = std::max(wx * wx + wy * wy, 1e-12);
    for (const Pole &pole : forest.poles) {
        const double ox = pole.x - a[0], oy = pole.y - a[1];
        const double share = std::clamp((ox * wx + oy * wy) / length2, 0.0, 1.0);
        const double dx = ox - wx * share, dy = oy - wy * share;
        if (dx * dx + dy * dy < pole.r * pole.r) return false;
    }
    return true;
}

struct Exact : ob::MotionValidator {
    const Forest &forest;
    Exact(const ob::SpaceInformationPtr &si, const Forest &forest) : ob::MotionValidator(si), forest(forest) {}
    bool checkMotion(const ob::State *a, const ob::State *b) const override { return clear(forest, at(a), at(b)); }
    bool checkMotion(const ob::State *a, const ob::State *b, std::pair<ob::State *, double> &last) const override {
        last.second = 0.0;
        return checkMotion(a, b);
    }
};

static ob::PlannerPtr made(const std::string &name, const ob::SpaceInformationPtr &si) {
    if (name == "BIT*") return std::make_shared<og::BITstar>(si);
    if (name == "ABIT*") return std::make_shared<og::ABITstar>(si);
    if (name == "InformedRRT*") return std::make_shared<og::InformedRRTstar>(si);
    return std::make_shared<og::RRTConnect>(si);
}

static void run(const std::string &name, const Forest &forest, const std::vector<double> &times_ms) {
    auto space = std::make_shared<ob::RealVectorStateSpace>(3);
    ob::RealVectorBounds bounds(3);
    for (int axis = 0; axis < 3; ++axis) {
        bounds.setLow(axis, forest.least[axis]);
        bounds.setHigh(axis, forest.most[axis]);
    }
    space->setBounds(bounds);
    og::SimpleSetup setup(space);
    auto si = setup.getSpaceInformation();
    setup.setStateValidityChecker([&](const ob::State *state) { return clear(forest, at(state), at(state)); });
    si->setMotionValidator(std::make_shared<Exact>(si, forest));
    ob::ScopedState<> from(space), to(space);
    for (int axis = 0; axis < 3; ++axis) { from[axis] = forest.from[axis]; to[axis] = forest.to[axis]; }
    setup.setStartAndGoalStates(from, to);
    setup.setOptimizationObjective(std::make_shared<ob::PathLengthOptimizationObjective>(si));
    auto planner = made(name, si);
    setup.setPlanner(planner);
    setup.setup();

    const double none = std::numeric_limits<double>::infinity();
    auto pdef = setup.getProblemDefinition();
    double spent_ms = 0.0, first_ms = none;
    auto begun = Clock::now();
    const auto passed_ms = [&] { return std::chrono::duration<double, std::milli>(Clock::now() - begun).count(); };
    // Optimising planners tell of a path when they find it, and have it in the end.
    pdef->setIntermediateSolutionCallback([&](const ob::Planner *, const std::vector<const ob::State *> &, const ob::Cost) {
        first_ms = std::min(first_ms, spent_ms + passed_ms());
    });
    const auto plan_until = [&](double until_ms) {
        begun = Clock::now();
        const double left_ms = until_ms - spent_ms;
        planner->solve(ob::PlannerTerminationCondition([&] { return passed_ms() >= left_ms; }));
        spent_ms += passed_ms();
        if (pdef->hasExactSolution()) first_ms = std::min(first_ms, spent_ms);
    };
    std::vector<double> lengths;
    for (double until_ms : times_ms) {
        // RRT-Connect has but one path; the others go on where they were.
        while (spent_ms < until_ms && !(name == "RRTConnect" && pdef->hasExactSolution())) plan_until(until_ms);
        if (!pdef->hasExactSolution()) {
            lengths.insert(lengths.end(), 2, none);
            continue;
        }
        og::PathGeometric path(*pdef->getSolutionPath()->as<og::PathGeometric>());
        lengths.push_back(path.length());
        og::PathSimplifier(si).shortcutPath(path);
        lengths.push_back(path.length());
    }
    std::cout << name << ' ' << first_ms;
    for (double length_m : lengths) std::cout << ' ' << length_m;
    std::cout << std::endl;
}

int main(int count, char **arguments) {
    ompl::msg::setLogLevel(ompl::msg::LOG_NONE);
    ompl::RNG::setSeed(1);
    std::vector<double> times_ms;
    for (int index = 1; index < count; ++index) times_ms.push_back(std::stod(arguments[index]));
    std::string word;
    while (std::cin >> word) {
        Forest forest;
        for (double *three : {forest.from, forest.to, forest.least, forest.most})
            std::cin >> three[0] >> three[1] >> three[2];
        std::size_t poles = 0;
        std::cin >> poles;
        forest.poles.resize(poles);
        for (Pole &pole : forest.poles) std::cin >> pole.x >> pole.y >> pole.r;
        for (const char *name : {"BIT*", "ABIT*", "InformedRRT*", "RRTConnect"}) run(name, forest, times_ms);
    }
}
