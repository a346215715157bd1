// A humanoid avatar, moved as receivers of the VMC protocol move theirs. Three's world is
// right-handed, Y up, and its avatars look along Z as Unity's do: what is x there is -x here.

import * as THREE from "three";
import { GLTFLoader } from "three/addons/loaders/GLTFLoader.js";
import { MeshoptDecoder } from "three/addons/libs/meshopt_decoder.module.js";
import { VRMHumanBoneList, VRMHumanoid } from "vrm";
import { url } from "mannequin";

const beside = new URLSearchParams(location.search).has("markers"); // shows them at its right hand
const [WIDTH, HEIGHT] = beside ? [760, 640] : [640, 640];
const APART = 1.2; // m from the markers to the avatar
const FRONT = 3.4; // m from the avatar to the camera
const MIDDLE = 1.05; // m above the floor, where the camera looks
const UP = new THREE.Vector3(0, 1, 0);

const scene = new THREE.Scene();
scene.background = new THREE.Color(0xeceff2);
scene.fog = new THREE.Fog(scene.background, 5, 12);
scene.add(floor(), new THREE.HemisphereLight(0xffffff, 0xb8b4b0, 1.4));
const sun = new THREE.DirectionalLight(0xffffff, 1.8);
sun.castShadow = true;
sun.shadow.mapSize.set(1024, 1024);
sun.shadow.camera = new THREE.OrthographicCamera(-3, 3, 3, -3, 0.1, 12);
scene.add(sun, sun.target);
const camera = new THREE.PerspectiveCamera(42, WIDTH / HEIGHT, 0.1, 50);
const renderer = new THREE.WebGLRenderer({ antialias: true });
renderer.shadowMap.enabled = true;
renderer.setSize(WIDTH, HEIGHT);
document.body.append(renderer.domElement);

// The model, normalised as VRM says: in the T that it comes in, no bone is turned.
const model = (await new GLTFLoader().setMeshoptDecoder(MeshoptDecoder).loadAsync(url)).scene;
const bones = {};
for (const name of VRMHumanBoneList) {
  const node = model.getObjectByName(name);
  if (node) bones[name] = { node };
}
model.traverse((each) => {
  each.castShadow = true;
  each.frustumCulled = false; // by the bounds of the T
});
const humanoid = new VRMHumanoid(bones);
const avatar = new THREE.Group(); // VMC's root
avatar.add(model, humanoid.normalizedHumanBonesRoot);
const cloud = new THREE.Group();
cloud.visible = beside;
scene.add(avatar, cloud);
const rest = places();

let bundles = 0;
const received = {
  "/VMC/Ext/Root/Pos": ([, ...values]) => {
    avatar.position.copy(position(values));
    avatar.quaternion.copy(rotation(values));
  },
  "/VMC/Ext/Bone/Pos": ([name, ...values]) => {
    const bone = humanoid.getNormalizedBoneNode(name[0].toLowerCase() + name.slice(1));
    if (!bone) return; // of a hand with other fingers
    bone.quaternion.copy(rotation(values));
    if (name === "Hips") bone.position.copy(position(values));
  },
  "/VMC/Ext/Tra/Pos": ([label, ...values]) => {
    marker(label).position.copy(position(values));
  },
};

function position([x, y, z]) {
  return new THREE.Vector3(-x, y, z);
}

/** What mirrors x turns left-handed into right-handed: about y and z the other way round. */
function rotation([, , , x, y, z, w]) {
  return new THREE.Quaternion(x, -y, -z, w);
}

/** A ball: left ones are blue, right ones red. */
function marker(label) {
  const known = cloud.getObjectByName(label);
  if (known) return known;
  const color = { L: 0x1668c7, R: 0xc8323c }[label[0]] ?? 0x505860;
  const ball = new THREE.Mesh(
    new THREE.SphereGeometry(0.022),
    new THREE.MeshStandardMaterial({ color }),
  );
  ball.name = label;
  ball.castShadow = true;
  cloud.add(ball);
  return ball;
}

function floor() {
  const pixels = [200, 184, 184, 200].flatMap((grey) => [grey, grey, grey, 255]);
  const squares = new THREE.DataTexture(new Uint8Array(pixels), 2, 2);
  squares.wrapS = squares.wrapT = THREE.RepeatWrapping;
  squares.repeat.set(40, 40);
  squares.needsUpdate = true;
  const plane = new THREE.Mesh(
    new THREE.PlaneGeometry(40, 40),
    new THREE.MeshLambertMaterial({ map: squares }),
  );
  plane.rotation.x = -Math.PI / 2;
  plane.receiveShadow = true;
  return plane;
}

/** Where the joints are in the world, by name: those that the skin hangs on. */
function places() {
  scene.updateMatrixWorld(true);
  const place = ({ node }) => node.getWorldPosition(new THREE.Vector3()).toArray();
  return Object.fromEntries(Object.entries(bones).map(([name, bone]) => [name, place(bone)]));
}

/** Draws what came last, from in front of the avatar; where its joints are. */
function draw() {
  humanoid.update();
  const joints = places();
  const at = (name) => new THREE.Vector3(...joints[name]);
  const left = at("leftUpperLeg").sub(at("rightUpperLeg")).setY(0).normalize();
  const front = left.clone().cross(UP);
  const middle = at("hips").setY(0);
  cloud.position.copy(left).multiplyScalar(-APART);
  if (beside) middle.addScaledVector(left, -APART / 2);
  camera.position.copy(middle).addScaledVector(front, FRONT).setY(MIDDLE + 0.3);
  camera.lookAt(middle.x, MIDDLE, middle.z);
  sun.target.position.copy(middle);
  sun.position.copy(middle).addScaledVector(front, 2).addScaledVector(left, 1.5).setY(5);
  renderer.render(scene, camera);
  return joints;
}

/**
 * bundles: how many have come. rest, joints: metres, by name. pixels: where the joints are in the
 * picture, a PNG in base64.
 */
function drawn() {
  const joints = draw();
  const pixel = (joint) => {
    const { x, y } = new THREE.Vector3(...joint).project(camera);
    return [((1 + x) / 2) * WIDTH, ((1 - y) / 2) * HEIGHT];
  };
  const pixels = Object.fromEntries(Object.entries(joints).map(([k, v]) => [k, pixel(v)]));
  const picture = renderer.domElement.toDataURL("image/png").split(",")[1];
  return { bundles, rest, joints, pixels, picture };
}

let next = 0; // the drawing that is due
const events = new EventSource("/events");
events.addEventListener("vmc", ({ data }) => {
  for (const { address, values } of JSON.parse(data)) received[address]?.(values);
  bundles += 1;
  cancelAnimationFrame(next);
  next = requestAnimationFrame(draw);
});
events.addEventListener("draw", () => {
  fetch("/picture", { method: "POST", body: JSON.stringify(drawn()) });
});
draw();
