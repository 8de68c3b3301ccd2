"""Renders one view with Blender's Cycles on the CPU:  blender -b -P cycles.py -- JOB.json

JOB.json holds scene, out, width, height, spp, bounces, seed, threads, position, target,
fov_y_degrees (null: the file's first camera), env, sky. Box filter, no clamping, no adaptive
sampling, no denoising; a linear float EXR. Prints one line: CYCLES_RENDER_CPU_S, the process's CPU
seconds (user and system) inside the render call, synchronisation and hierarchy included.
"""

import json
import math
import os
import sys

import numpy

numpy.bool = bool  # The importer of Blender 3.4 uses a name that numpy 1.24 dropped.

import bpy
import mathutils


def gltf_vector(v):
    """glTF's y up to Blender's z up."""
    return mathutils.Vector((v[0], -v[2], v[1]))


def set_sampling(scene, job):
    cycles = scene.cycles
    cycles.device = "CPU"
    cycles.samples = job["spp"]
    cycles.seed = job["seed"]
    cycles.use_adaptive_sampling = False
    cycles.use_denoising = False
    for bounces in ("max_bounces", "diffuse_bounces", "glossy_bounces", "transmission_bounces",
                    "transparent_max_bounces"):
        setattr(cycles, bounces, job["bounces"])
    cycles.sample_clamp_direct = 0
    cycles.sample_clamp_indirect = 0
    cycles.blur_glossy = 0
    cycles.caustics_reflective = True
    cycles.caustics_refractive = True
    cycles.pixel_filter_type = "BOX"
    cycles.filter_width = 1


def set_output(scene, job):
    render = scene.render
    render.threads_mode = "FIXED"
    render.threads = job["threads"]
    render.resolution_x, render.resolution_y = job["width"], job["height"]
    render.resolution_percentage = 100
    render.image_settings.file_format = "OPEN_EXR"
    render.image_settings.color_depth = "32"
    render.filepath = job["out"]
    scene.view_settings.view_transform = "Raw"


def set_light(scene, job):
    world = bpy.data.worlds.new("light")
    scene.world = world
    world.use_nodes = True
    background = world.node_tree.nodes["Background"]
    sky = job["sky"] or 0
    background.inputs["Color"].default_value = (sky, sky, sky, 1)
    if job["env"]:
        texture = world.node_tree.nodes.new("ShaderNodeTexEnvironment")
        texture.image = bpy.data.images.load(job["env"])
        texture.image.colorspace_settings.name = "Linear"
        world.node_tree.links.new(texture.outputs["Color"], background.inputs["Color"])


def set_camera(scene, job):
    if job["position"] is None:
        scene.camera = next(o for o in bpy.data.objects if o.type == "CAMERA")
        return
    camera = bpy.data.cameras.new("view")
    camera.sensor_fit = "VERTICAL"
    camera.angle = math.radians(job["fov_y_degrees"])
    camera.clip_start, camera.clip_end = 1e-4, 1e6
    placed = bpy.data.objects.new("view", camera)
    position = gltf_vector(job["position"])
    placed.location = position
    towards = gltf_vector(job["target"]) - position
    placed.rotation_euler = towards.to_track_quat("-Z", "Y").to_euler()
    scene.collection.objects.link(placed)
    scene.camera = placed


def cpu_seconds():
    times = os.times()
    return times.user + times.system


def main():
    with open(sys.argv[sys.argv.index("--") + 1], encoding="utf-8") as file:
        job = json.load(file)
    bpy.ops.wm.read_factory_settings(use_empty=True)
    # COMPAT: one candela is one watt per steradian, as it is for Tessera; the default divides by 683.
    bpy.ops.import_scene.gltf(filepath=job["scene"], convert_lighting_mode="COMPAT")
    scene = bpy.context.scene
    scene.render.engine = "CYCLES"
    set_sampling(scene, job)
    set_output(scene, job)
    set_light(scene, job)
    set_camera(scene, job)
    start = cpu_seconds()
    bpy.ops.render.render(write_still=True)
    print("CYCLES_RENDER_CPU_S", cpu_seconds() - start, flush=True)


main()
