/** The surface in three dimensions with the true path and the forecasts' over it. */

import * as THREE from "../vendor/three/three.module.min.js";
import { byId, styled } from "./dom.js";
import { contoursOf, meshOf, restingHeight } from "./ground.js";
import { onPage } from "./palette.js";
import { LAST_SEEN } from "./state.js";

const START = { azimuth: -0.5, polar: 0.66, distance: 3.9 };
/** Those of the pictures; a single ball is textured there. */
const BALLS = ["#d23a32", "#2f9a45", "#3a63dc"];
const SINGLE = "#f4f1ea";
const REBUILD_MS = 150;

export class Surface3d {
  constructor() {
    this._canvas = byId("surface");
    this._view = { ...START };
    this._index = 0;
    const context = this._canvas.getContext("webgl2", { antialias: true, alpha: true });
    if (!context) return; // show() says so
    this._renderer = new THREE.WebGLRenderer({ canvas: this._canvas, context });
    this._camera = new THREE.PerspectiveCamera(34, 1, 0.1, 50);
    this._camera.up.set(0, 0, 1);
    this._scene = new THREE.Scene();
    this._lights();
    this._paths = new THREE.Group();
    this._ground = new THREE.Group();
    this._balls = new THREE.Group();
    this._scene.add(this._ground, this._paths, this._balls);
    this._listen();
    new ResizeObserver(() => this._draw()).observe(this._canvas);
  }

  /** Show a scene and its forecasts; none for footage, whose ground is unknown. */
  show(take, forecasts) {
    const message = this._renderer
      ? take?.surface
        ? ""
        : "The ground of your footage is unknown; only simulated scenes have a surface."
      : "This browser shows no 3D (WebGL is missing or switched off).";
    byId("surface-note").textContent = message;
    this._canvas.hidden = message !== "";
    if (message) return;
    if (take.surface !== this._surface) this._setGround(take);
    this._take = take;
    this._forecasts = forecasts;
    if (this._isDue(take, forecasts)) this._setPaths();
    this.mark(this._index);
  }

  /** Whether paths have grown; while they do so step by step, not for every one of them. */
  _isDue(take, forecasts) {
    const shown = `${take.key} ${take.frames.length} ${forecasts.map(({ name, times }) => name + times.length)}`;
    const isGrowing = forecasts.some(({ state }) => state === "streaming");
    const now = performance.now();
    if (shown === this._shown || (isGrowing && now - this._shownAt < REBUILD_MS)) return false;
    this._shown = shown;
    this._shownAt = now;
    return true;
  }

  /** Put the balls where they are at a frame. */
  mark(index) {
    this._index = index;
    if (!this._renderer || !this._take || this._canvas.hidden) return;
    for (const ball of this._balls.children) {
      const { positions, first } = ball.userData;
      const at = positions[Math.min(Math.max(index - first, 0), positions.length - 1)];
      ball.visible = at !== undefined && index >= first;
      if (ball.visible) ball.position.copy(at);
    }
    this._draw();
  }

  recolor() {
    if (!this._take) return;
    this._setGround(this._take);
    this._setPaths();
    this.mark(this._index);
  }

  reset() {
    this._view = { ...START };
    this._draw();
  }

  _lights() {
    const sun = new THREE.DirectionalLight(0xffffff, 2.2);
    sun.position.set(-2, 2.5, 4);
    this._scene.add(sun, new THREE.HemisphereLight(0xffffff, 0x99a1ad, 1.5));
  }

  _setGround({ surface, scenario }) {
    this._surface = surface;
    empty(this._ground);
    const isBowl = scenario === "hemisphere" || scenario === "ellipsoid";
    const mesh = meshOf(surface);
    const geometry = new THREE.BufferGeometry();
    geometry.setAttribute("position", new THREE.Float32BufferAttribute(mesh.points.flat(), 3));
    geometry.setAttribute("color", new THREE.Float32BufferAttribute(shades(mesh.points), 3));
    geometry.setIndex(mesh.triangles.flat());
    geometry.computeVertexNormals();
    const material = new THREE.MeshStandardMaterial({
      vertexColors: true,
      roughness: 0.95,
      side: THREE.DoubleSide,
      polygonOffset: true,
      polygonOffsetFactor: 1,
      polygonOffsetUnits: 1,
    });
    const lines = new THREE.BufferGeometry();
    const ends = contoursOf(mesh, isBowl).flat();
    lines.setAttribute("position", new THREE.Float32BufferAttribute(ends, 3));
    const color = new THREE.Color(styled("--contour"));
    const contours = new THREE.LineBasicMaterial({ color, transparent: true, opacity: 0.5 });
    this._ground.add(new THREE.Mesh(geometry, material), new THREE.LineSegments(lines, contours));
    this._middle = isBowl ? 0.42 : 0;
  }

  _setPaths() {
    empty(this._paths);
    empty(this._balls);
    const { truth, radiusM } = this._take;
    for (const [number, ball] of (truth ?? []).entries()) {
      const positions = this._lifted(ball.positions);
      this._addTube(positions, styled("--truth-3d"), 0.013);
      this._addBall(positions, 0, radiusM, truth.length > 1 ? BALLS[number] : SINGLE, 0.6);
    }
    for (const { objects, slot } of this._forecasts) {
      for (const ball of objects) {
        const positions = this._lifted(ball.positions);
        this._addTube(positions, onPage(slot), 0.02);
        this._addBall(positions, LAST_SEEN, Math.max(radiusM * 0.35, 0.035), onPage(slot), 1);
      }
    }
  }

  /** From pixels to the centre of a ball that lies there. */
  _lifted(positions) {
    const { half_width_m: half } = this._surface;
    const metres = (2 * half) / this._take.frameSize;
    return positions.map(([column, row]) => {
      const [x, y] = [column * metres - half, half - row * metres];
      return new THREE.Vector3(x, y, restingHeight(this._surface, x, y, this._take.radiusM));
    });
  }

  _addTube(positions, color, radius) {
    if (positions.length < 2) return;
    const curve = new THREE.CatmullRomCurve3(positions);
    const geometry = new THREE.TubeGeometry(curve, positions.length * 3, radius, 8);
    this._paths.add(new THREE.Mesh(geometry, new THREE.MeshBasicMaterial({ color })));
  }

  _addBall(positions, first, radius, color, opacity) {
    const material = new THREE.MeshStandardMaterial({
      color,
      roughness: 0.45,
      opacity,
      transparent: opacity < 1,
    });
    const ball = new THREE.Mesh(new THREE.SphereGeometry(radius, 32, 20), material);
    ball.userData = { positions, first };
    this._balls.add(ball);
  }

  _draw() {
    if (!this._renderer || this._canvas.hidden || !this._surface) return;
    if (this._isAsked) return; // asking anew would put it off, again and again
    this._isAsked = true;
    requestAnimationFrame(() => {
      this._isAsked = false;
      const { clientWidth: width, clientHeight: height } = this._canvas;
      if (!width || !height) return;
      this._renderer.setPixelRatio(Math.min(devicePixelRatio, 2));
      this._renderer.setSize(width, height, false);
      this._camera.aspect = width / height;
      this._camera.updateProjectionMatrix();
      const { azimuth, polar, distance } = this._view;
      this._camera.position
        .setFromSphericalCoords(distance, polar, 0)
        .applyAxisAngle(new THREE.Vector3(1, 0, 0), Math.PI / 2)
        .applyAxisAngle(new THREE.Vector3(0, 0, 1), azimuth);
      this._camera.position.z += this._middle;
      this._camera.lookAt(0, 0, this._middle);
      this._renderer.render(this._scene, this._camera);
    });
  }

  _turn(azimuth, polar, nearer = 1) {
    this._view.azimuth += azimuth;
    this._view.polar = Math.min(Math.max(this._view.polar + polar, 0.02), 1.5);
    this._view.distance = Math.min(Math.max(this._view.distance * nearer, 2), 8);
    this._draw();
  }

  _listen() {
    const canvas = this._canvas;
    canvas.addEventListener("pointerdown", (event) => canvas.setPointerCapture(event.pointerId));
    canvas.addEventListener("pointermove", (event) => {
      if (!canvas.hasPointerCapture(event.pointerId)) return;
      this._turn(-event.movementX * 0.008, -event.movementY * 0.008);
    });
    canvas.addEventListener(
      "wheel",
      (event) => {
        if (document.activeElement !== canvas) return; // the page scrolls on
        event.preventDefault();
        this._turn(0, 0, Math.exp(event.deltaY * 0.001));
      },
      { passive: false },
    );
    canvas.addEventListener("keydown", (event) => {
      const turns = {
        ArrowLeft: [0.1, 0], ArrowRight: [-0.1, 0], ArrowUp: [0, -0.1], ArrowDown: [0, 0.1],
        "+": [0, 0, 0.9], "=": [0, 0, 0.9], "-": [0, 0, 1.1],
      };
      const turn = turns[event.key];
      if (!turn) return;
      event.preventDefault();
      this._turn(...turn);
    });
  }
}

/** Darker below, lighter above. */
function shades(points) {
  const heights = points.map((point) => point[2]);
  const [low, high] = [Math.min(...heights), Math.max(...heights)];
  const [below, above] = ["--ground-low", "--ground-high"].map((name) => new THREE.Color(styled(name)));
  return heights.flatMap((height) => {
    const color = below.clone().lerp(above, (height - low) / (high - low || 1));
    return [color.r, color.g, color.b];
  });
}

function empty(group) {
  for (const child of group.children) {
    child.geometry.dispose();
    child.material.dispose();
  }
  group.clear();
}
