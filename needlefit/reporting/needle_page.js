(()=>{var __getOwnPropNames=Object.getOwnPropertyNames;var __esm=(fn,res,err)=>function(){if(err)throw err[0];try{return fn&&(res=(0,fn[__getOwnPropNames(fn)[0]])(fn=
0)),res}catch(e){throw err=[e],e}};function check(fault){if(fault)throw new TypeError(`the kernel refuses a problem: ${FAULTS[Number(fault)]}`)}function makeProblem(heap,fields2,arrays){
let f=fields2,n=f.sets*f.layers,counts={boundaries:f.layers-1,rigidity:f.sets,mu:n,thickness:n,friction:n,law:n*
f.numbers,turn:f.bevels*f.sets*f.planes,base:3*f.inputs*f.sets*f.planes,before_first:f.inputs+1,within_first:f.
inputs+1,held_tip:2*f.inputs*f.planes,guide_x:f.sets};for(let[name,count]of Object.entries(counts))if((arrays[name]||
name!=="guide_x")&&arrays[name].length!==count)throw new TypeError(`${name} has ${arrays[name].length} numbers\
, not ${count}`);let addresses=ARRAYS.map(name=>arrays[name]?heap.put(arrays[name]):0),at=makeStructure(heap,f,
addresses),sizes=heap.take(24);check(heap.call.nf_check(at,sizes));let[room,points,quadrature]=heap.integers(sizes,
3);return{at,sizes,fields:f,arrays:Object.fromEntries(ARRAYS.map((name,i)=>[name,addresses[i]])),room:Number(room),
maxPoints:Number(points),maxQuadrature:Number(quadrature)}}function rewrite(heap,problem,arrays){for(let[name,
array]of Object.entries(arrays))heap.put(array,problem.arrays[name]);check(heap.call.nf_check(problem.at,problem.
sizes))}function makeShapes(heap,problem,points){let{sets,columns:columns2,planes}=problem.fields,{room}=problem,
counts={x:sets*room,u:planes*sets*room,slope:planes*sets*room,constraints:(1+planes)*sets*points,track:2*planes*
sets*points,status:sets,passes:sets,nodes:1,u_by:planes*sets*room*columns2,slope_by:planes*sets*room*columns2,
constraints_by:planes*sets*points*columns2,track_by:planes*sets*points*columns2},shapes={points,counts,room,planes};
for(let[name,count]of Object.entries(counts))shapes[name]=columns2||!name.endsWith("_by")?heap.take(8*count):0;
return shapes.at=heap.structure([room,points],[],Object.keys(counts).map(name=>shapes[name])),shapes}function readPlanes(heap,shapes,name,planes,nodes){
let read=new Float64Array(planes*nodes);for(let plane=0;plane<planes;plane+=1)read.set(heap.floats(shapes[name]+
8*plane*shapes.room,nodes),plane*nodes);return read}function readShape(heap,shapes,points){let{planes}=shapes,
number=name=>Number(heap.integers(shapes[name],1)[0]),read=(name,count)=>heap.floats(shapes[name],count).slice(),
nodes=number("nodes"),x=read("x",nodes);return{status:STATUS[number("status")],passes:number("passes"),depth:x.
at(-1),planes,x,u:readPlanes(heap,shapes,"u",planes,nodes),slope:readPlanes(heap,shapes,"slope",planes,nodes),
constraints:read("constraints",(1+planes)*points),track:read("track",2*planes*points)}}var STATUS,FAULTS,SIZES,
NUMBERS,ARRAYS,compile,Heap,makeStructure,init_memory=__esm({"needlefit/mechanics/native/memory.js"(){STATUS=[
"converged","over-compressed","not converged","non-finite"],FAULTS=["","size","mesh","stop","guides","column",
"output","points"],SIZES="planes sets layers shapes terms numbers stop_count bevels inputs rays guides columns\
 max_iterations".split(" "),NUMBERS="length first_cell spacing element part tangent tolerance deepest".split("\
 "),ARRAYS="boundaries stops rigidity mu thickness friction law law_by turn base before_first within_first bef\
ore within held_tip guide_x turn_by column_of guide_columns".split(" "),compile=bytes=>WebAssembly.compile(bytes),
Heap=class _Heap{constructor(instance){this.call=instance.exports,this.memory=instance.exports.memory,this.top=
this.bottom=this.memory.buffer.byteLength}static async make(kernel){return new _Heap(await WebAssembly.instantiate(
kernel,{}))}take(bytes){let at=Math.ceil(this.top/64)*64;this.top=at+Number(bytes);let missing=this.top-this.memory.
buffer.byteLength;return missing>0&&this.memory.grow(Math.ceil(missing/65536)),at}put(array,at=this.take(array.
byteLength)){return new Uint8Array(this.memory.buffer,at,array.byteLength).set(new Uint8Array(array.buffer,array.
byteOffset,array.byteLength)),at}borrow(work2){let top=this.top;try{return work2()}finally{this.top=top}}evaluate(which,x){
return this.borrow(()=>{let[at,out]=[this.put(Float64Array.of(x)),this.take(8)];return this.call.nf_function(BigInt(
which),1n,at,out),this.floats(out,1)[0]})}floats(at,count){return new Float64Array(this.memory.buffer,at,count)}integers(at,count){
return new BigInt64Array(this.memory.buffer,at,count)}view(at){return new DataView(this.memory.buffer,at)}structure(integers,numbers,addresses){
let at=this.take(8*(integers.length+numbers.length)+4*addresses.length),view2=this.view(at);return integers.forEach(
(value,i)=>view2.setBigInt64(8*i,BigInt(value),!0)),numbers.forEach((value,i)=>view2.setFloat64(8*(integers.length+
i),value,!0)),addresses.forEach((value,i)=>view2.setUint32(8*(integers.length+numbers.length)+4*i,value,!0)),at}};
makeStructure=(heap,fields2,addresses)=>heap.structure(SIZES.map(name=>fields2[name]),NUMBERS.map(name=>fields2[name]),
addresses)}});function completeInputs(inputs){let{bevel={},base={},guides:guides2=[],tip=null}=inputs;return{bevel:{side:1,roll:0,
strength:0,...bevel},base:{y:0,slope:0,stageSlope:0,...base},guides:guides2.map(guide=>({y:0,slope:0,...guide})).
sort((a,b)=>a.x-b.x),tip}}function checkInputs(model,inputs,depth){let{guides:guides2}=inputs,base=depth-model.
length,ends=[base,...guides2.map(guide=>guide.x)];for(let name of["mu","thickness"])if(!model[name].every(value=>value>
0))throw new RangeError(`${name} is not above 0`);if(!(model.rigidity>0&&base<0))throw new RangeError("the nee\
dle is too short, or its rigidity not above 0");if(guides2.length>MAX_GUIDES)throw new RangeError(`${guides2.length}\
 guides; there may be ${MAX_GUIDES}`);if(ends.some((x,i)=>i>0&&!(x>ends[i-1])))throw new RangeError(`base and \
guides stand at ${ends} mm; they must increase`)}function findToward(heap,{side,roll:roll2}){if(roll2===0)return[
side,0];let quarters=Math.floor(roll2/90+.5),rest=(roll2-90*quarters)*(Math.PI/180),[z,y]=[3,4].map(which=>side*
heap.evaluate(which,rest));return[[y,z],[-z,y],[-y,-z],[z,-y]].at(quarters%4)}function listGuides(guides2,planes){
let listed=new Float64Array((1+2*planes)*MAX_GUIDES);return guides2.forEach(({x,y,slope:slope2},i)=>listed.set(
[x,...listHeld(y,slope2,0,planes)],i*(1+2*planes))),listed}function packInputs(heap,{bevel,base,guides:guides2,
tip},model,{sets,strength=null},planes){let before2=guides2.filter(guide=>guide.x<0),within2=guides2.filter(guide=>guide.
x>=0),toward=findToward(heap,bevel).slice(0,planes),turn2=(part2,set)=>part2*(strength?.[set]??bevel.strength)/
(model.pathAngle?1:model.spacing);return{turn:Float64Array.from(Array.from({length:sets},(_,set)=>toward.map(part2=>turn2(
part2,set))).flat()),base:repeat([...listBase(base),0,0,0].slice(0,3*planes),sets),before_first:BigInt64Array.
of(0n,BigInt(before2.length)),within_first:BigInt64Array.of(0n,BigInt(within2.length)),before:listGuides(before2,
planes),within:listGuides(within2,planes),held_tip:Float64Array.from(listTip(tip,planes))}}function pack(heap,model,inputs,values,planes,more){
let{sets}=values,layers=model.mu.length,ofLayers=["mu","thickness","friction","law"].map(name=>[name,values[name]??
repeat(model[name],sets)]),arrays={boundaries:Float64Array.from(model.boundaries),stops:new Uint8Array(STOP_BYTES),
rigidity:repeat([model.rigidity],sets),...Object.fromEntries(ofLayers),...packInputs(heap,inputs,model,values,
planes)};return[{planes,sets,layers,shapes:1,terms:model.terms,numbers:model.law.length/layers,stop_count:1,bevels:1,
inputs:1,guides:MAX_GUIDES,columns:0,max_iterations:model.maxIterations??40,length:model.length,first_cell:model.
firstCell,spacing:model.spacing,element:model.element,part:model.pathAngle?LINEAR_CUT:model.switch??.5,tangent:model.
tangent??1,tolerance:model.tolerance??1e-7,...more},arrays]}function findPositions(heap,planes,nodes,addresses,s){
return heap.borrow(()=>{let size3=(1+planes)*s.length,out=heap.take(8*size3),memory=heap.take(8*(1+5*planes)*(nodes+
2)*Number(heap.call.nf_lanes())),counts=[planes,1,nodes,s.length].map(BigInt);return heap.call.nf_positions(...counts,
...addresses,heap.put(s),memory,out),heap.floats(out,size3).slice()})}var SAME_DEPTH,MAX_ELEMENTS,MAX_GUIDES,LINEAR_CUT,
MAX_RAYS,KEPT_IDS,STOP_BYTES,MOVE_BYTES,POSITION_BYTES,findDeepest,isPlanar,listHeld,repeat,listTip,listBase,bevelKey,
controlsKey,Session,SessionBatch,init_needle=__esm({"needlefit/mechanics/native/needle.js"(){init_memory();SAME_DEPTH=
1e-9,MAX_ELEMENTS=5e3,MAX_GUIDES=50,LINEAR_CUT=-1,MAX_RAYS=15e3,KEPT_IDS=256,STOP_BYTES=48,MOVE_BYTES=24,POSITION_BYTES=
64,findDeepest=model=>Math.min(model.length,MAX_ELEMENTS*model.element);isPlanar=(heap,{bevel,tip})=>findToward(
heap,bevel)[1]===0&&!tip?.z;listHeld=(y,slope2,z,planes)=>[y,slope2??NaN,z,(slope2??null)===null?NaN:0].slice(
0,2*planes),repeat=(numbers,sets)=>Float64Array.from({length:sets*numbers.length},(_,i)=>numbers[i%numbers.length]),
listTip=(tip,planes)=>tip?listHeld(tip.y,tip.slope,tip.z??0,planes):Array(2*planes).fill(NaN),listBase=base=>[
base.y,base.slope,base.stageSlope],bevelKey=({bevel})=>JSON.stringify([bevel.side,bevel.roll,bevel.strength]),
controlsKey=({base,guides:guides2,tip})=>JSON.stringify([listBase(base),guides2.map(guide=>[guide.x,guide.y,guide.
slope??null]),listTip(tip,2)]);Session=class _Session{static async begin(kernel,model,inputs={}){return new _Session(
await Heap.make(kernel),model,completeInputs(inputs))}heap;start;base;end;model;planes;depth;rays;ids;maxIds;solved;parts;stateBytes;constructor(heap,model,inputs){
Object.assign(this,{heap,start:heap.top,failed:!1}),this.#begin(model,inputs)}#begin(model,inputs,planes=model.
spatial||!isPlanar(this.heap,inputs)?2:this.planes??1){this.deepest=findDeepest(model);let rays=Math.ceil(this.
deepest/model.spacing);this.#layOut({model,inputs,planes,depth:0,ids:new Map,maxIds:KEPT_IDS,solved:0,shape:null,
rays}),this.shape=this.go(0,inputs)}#layOut(fields2){Object.assign(this,fields2,{base:this.start}),this.#reserve()}#reserve(old){
let{heap,model,inputs,planes,rays,deepest:deepest2}=this,{call}=heap;heap.top=this.base;let problem=makeProblem(
heap,...pack(heap,model,inputs,{sets:1},planes,{rays,deepest:deepest2}));this.problem=problem,this.shapes=makeShapes(
heap,problem,problem.maxPoints),this.done=heap.take(24),call.nf_session_memory(problem.at,this.done);let[fixed,
state,scratch]=heap.integers(this.done,3).map(BigInt),parts={fixed:heap.take(fixed),now:heap.take(state),next:heap.
take(state),scratch:heap.take(scratch)};if(Object.assign(this,{parts,stateBytes:Number(state),end:heap.top}),call.
nf_session_begin(problem.at,parts.fixed,parts.now,parts.scratch),old){let{now:now2,scratch:room}=old.parts;call.
nf_session_copy(old.problem.at,problem.at,parts.fixed,now2,room,parts.now,parts.scratch)}}go(depth,given,accepts=_shape=>!0){
if(!(depth>=0&&depth<=this.deepest))throw new RangeError(`the needle cannot be ${depth} mm deep`);let inputs=completeInputs(
given),{heap}=this;if(checkInputs(this.model,inputs,depth),this.planes===1&&!isPlanar(heap,inputs)){let path=this.
path();this.#begin(this.model,path[0].inputs,2);for(let one of path)this.go(one.depth,one.inputs)}let before2=this.
inputs;this.inputs=inputs,rewrite(heap,this.problem,packInputs(heap,inputs,this.model,{sets:1},this.planes));let bevel=this.#number(
bevelKey(inputs),inputs.bevel),held=this.#number(controlsKey(inputs),inputs),advance2=()=>{let{fixed,now:now2,
next,scratch}=this.parts,{at}=this.problem;return[heap.call.nf_session_advance(at,fixed,now2,next,scratch,this.
shapes.at,depth,BigInt(bevel),BigInt(held),this.done),...heap.integers(this.done,3)].map(Number)},[fault,stops,
points,rays]=advance2();if(rays>MAX_RAYS)throw this.inputs=before2,new RangeError(`the needle has changed its \
direction of cutting ${rays} times`);if(rays>this.rays){let old={problem:this.problem,parts:this.parts};Object.
assign(this,{rays:2*rays,base:this.end}),this.#reserve(old),[fault,stops,points,rays]=advance2()}check(fault),
this.solved+=stops;let{shape}=this;return stops>0&&(shape=readShape(heap,this.shapes,points),this.failed=shape.
status!==STATUS[0]||!accepts(shape),this.failed)?(this.inputs=before2,shape):(this.failed=!1,[this.parts.now,this.
parts.next]=[this.parts.next,this.parts.now],Object.assign(this,{depth,shape}),this.ids.size>this.maxIds&&this.#dropUnused(
new Set([bevel,held])),shape)}#number(key,value){let found=this.ids.get(key);return found||(this.nextId=(this.
nextId??0)+1,this.ids.set(key,found={number:this.nextId,value})),found.number}#dropUnused(used){for(let{bevel,
held}of this.#listRays().rays)used.add(bevel).add(held);for(let[key,{number}]of this.ids)used.has(number)||this.
ids.delete(key);this.maxIds=KEPT_IDS+2*this.ids.size}#listRays(){let{heap,parts,problem}=this;return heap.borrow(
()=>{let cut=heap.take(MOVE_BYTES*this.rays),position=heap.take(POSITION_BYTES),count=Number(heap.call.nf_session_rays(
problem.at,parts.fixed,parts.now,parts.scratch,cut,position)),view2=heap.view(cut),id=at=>Number(view2.getBigInt64(
at,!0));return{rays:Array.from({length:count},(_,n)=>({start:view2.getFloat64(MOVE_BYTES*n,!0),bevel:id(MOVE_BYTES*
n+8),held:id(MOVE_BYTES*n+16)})),changed:heap.view(position).getBigInt64(POSITION_BYTES-8,!0)!==0n}})}save(){let{
model,inputs,planes,depth,shape,rays,ids,maxIds,solved,heap,parts,stateBytes}=this,state=new Uint8Array(heap.memory.
buffer,parts.now,stateBytes).slice();return{model,inputs,planes,depth,shape,rays,ids:new Map(ids),maxIds,solved,
state}}restore({state,...saved}){this.#layOut({...saved,ids:new Map(saved.ids)}),new Uint8Array(this.heap.memory.
buffer).set(state,this.parts.now)}path(){let{firstCell,spacing}=this.model,{rays,changed:changed2}=this.#listRays(),
values=new Map([...this.ids.values()].map(({number,value})=>[number,value])),alike=(one,other)=>one.bevel===other.
bevel&&one.held===other.held,flip2=({depth,inputs})=>({depth,inputs:{...inputs,bevel:{...inputs.bevel,side:-inputs.
bevel.side}}}),isPoint=depth=>{let cell=depth<=SAME_DEPTH?0:1+Math.max(0,Math.ceil((depth-firstCell-SAME_DEPTH)/
spacing));return Math.abs((cell&&firstCell+(cell-1)*spacing)-depth)<=SAME_DEPTH},steps2=[];rays.forEach(({start:start2,
bevel,held},n)=>{let depth=n+1<rays.length?rays[n+1].start:this.depth,step={depth,inputs:{...values.get(held),
bevel:values.get(bevel)}},again=n>0&&alike(rays[n-1],rays[n]);again&&isPoint(start2)?steps2.pop():again&&steps2.
push(flip2(steps2.at(-1))),steps2.push(step)});let last2={depth:this.depth,inputs:this.inputs},now2={bevel:this.#number(
bevelKey(this.inputs)),held:this.#number(controlsKey(this.inputs))};return!rays.length||!alike(rays.at(-1),now2)?
steps2.push(last2):changed2&&steps2.push(flip2(last2),last2),steps2}again(model,steps2){this.#begin(model,completeInputs(
steps2[0].inputs));for(let{depth,inputs}of steps2)if(this.go(depth,inputs),this.failed)return!1;return!0}deflections(s){
let{heap,shape}=this,nodes=shape.x.length;return heap.borrow(()=>{let[x,u,slope2,at]=[shape.x,shape.u,shape.slope,
Float64Array.from(s)].map(array=>heap.put(array)),out=heap.take(8*shape.planes*s.length);for(let plane=0;plane<
shape.planes;plane+=1){let there=[u,slope2].map(address=>address+8*plane*nodes);heap.call.nf_deflections(BigInt(
nodes),BigInt(s.length),x,...there,at,out+8*plane*s.length)}return heap.floats(out,shape.planes*s.length).slice()})}positions(s){
let{heap,shape}=this,at=Float64Array.from(s);if(!at.every(one=>one>=shape.x[0]&&one<=shape.depth))throw new RangeError(
"s lies beyond the needle");return heap.borrow(()=>findPositions(heap,shape.planes,shape.x.length,[shape.x,shape.
u,shape.slope].map(array=>heap.put(array)),at))}forces(){let{heap,shape,inputs,model,planes}=this,{call}=heap;
return heap.borrow(()=>{let depth=shape.depth,cells=shape.constraints.length/(1+planes)-1,depths=shape.constraints.
filter((_,i)=>i%(1+planes)===0),first=cells>0?depths[1]:model.spacing,deepest2=Math.max(depths.length*model.spacing,
depth)+first+2*model.spacing,problem=makeProblem(heap,...pack(heap,{...model,firstCell:first},inputs,{sets:1},
planes,{rays:1,deepest:deepest2})),memory=heap.take(call.nf_memory(problem.at,1n)),front=shape.x.findIndex(x=>x>=
0),room=problem.maxQuadrature,[s,weight,layer,near2]=[0,1,2,3].map(()=>heap.take(8*room)),[nodes,at]=[shape.x.
slice(front),depths].map(array=>heap.put(array)),count=Number(call.nf_quadrature(problem.at,BigInt(shape.x.length-
front),nodes,BigInt(cells),at,memory,s,weight,layer,near2));count<0&&check(7);let parts=[shape.x,shape.u,shape.
slope,shape.constraints].map(array=>heap.put(array)),bent=heap.structure([shape.x.length,cells],[],parts),load3=heap.
take(8*planes*count),nodal=heap.take(16*planes*shape.x.length);call.nf_load(problem.at,bent,BigInt(count),s,memory,
load3),check(call.nf_balance(problem.at,bent,BigInt(front),BigInt(count),load3,memory,nodal));let each=Array.from(
{length:planes},(_,plane)=>plane),held=heap.floats(nodal,2*planes*shape.x.length).slice(),size3=parts2=>planes===
1?parts2[0]:Math.hypot(...parts2),support=(x,part2)=>{let i=shape.x.indexOf(x);return each.map(plane=>i<0?0:held[2*
(plane*shape.x.length+i)+part2])},read=(x,clamped)=>({force:size3(support(x,0)),moment:clamped?size3(support(x,
1)):0}),[places,weights]=[s,weight].map(address=>heap.floats(address,count).slice()),loads=each.map(plane=>heap.
floats(load3+8*plane*count,count).slice()),nearest=heap.integers(near2,count),last2=loads.map(one=>one.reduce(
(sum,q,i)=>sum+(nearest[i]===BigInt(cells)?q*weights[i]:0),0));return{s:places,loads,tipForce:size3(inputs.tip?
support(depth,0).map((one,plane)=>last2[plane]+one):last2),base:read(shape.x[0],!0),guides:inputs.guides.map(guide=>read(
guide.x,(guide.slope??null)!==null))}})}};SessionBatch=class _SessionBatch{static async begin(kernel,model,values,rays,planes){
return new _SessionBatch(await Heap.make(kernel),model,values,rays,planes)}heap;model;values;planes;problem;ids;spare;scratch;bevel;held;constructor(heap,model,values,rays,planes){
let more={rays,deepest:findDeepest(model)},problem=makeProblem(heap,...pack(heap,model,completeInputs({}),values,
planes,more));Object.assign(this,{heap,model,values,planes,problem,ids:new Map});let{fields:fields2,arrays,maxPoints,
room}=problem,{layers,numbers}=fields2,stride={rigidity:1,mu:layers,thickness:layers,friction:layers,law:layers*
numbers,turn:planes,base:3*planes},alone={...fields2,sets:1};this.done=heap.take(24);let problems=Array.from({
length:fields2.sets},(_,i)=>makeStructure(heap,alone,ARRAYS.map(name=>arrays[name]&&arrays[name]+8*i*(stride[name]??
0))));heap.call.nf_session_memory(problems[0],this.done);let[fixed,state,scratch]=heap.integers(this.done,3).map(
BigInt);Object.assign(this,{spare:heap.take(state),scratch:heap.take(scratch)}),this.needles=problems.map(at=>{
let shapes=makeShapes(heap,{fields:alone,room},maxPoints);return{at,shapes,fixed:heap.take(fixed),state:heap.take(
state)}}),problems.forEach((_,i)=>this.restart(i))}restart(i){let{at,fixed,state}=this.needles[i];this.heap.call.
nf_session_begin(at,fixed,state,this.scratch)}hold(given){let{heap,ids}=this,inputs=completeInputs(given),number=key=>ids.
get(key)??ids.set(key,BigInt(ids.size+1)).get(key);rewrite(heap,this.problem,packInputs(heap,inputs,this.model,
this.values,this.planes)),Object.assign(this,{bevel:number(bevelKey(inputs)),held:number(controlsKey(inputs))})}go(i,depth){
let{heap,done:done2,scratch,spare,bevel,held}=this,needle=this.needles[i],{at,fixed,state,shapes}=needle;return check(
heap.call.nf_session_advance(at,fixed,state,spare,scratch,shapes.at,depth,bevel,held,done2)),heap.integers(done2,
1)[0]>0n&&heap.integers(shapes.status,1)[0]!==0n?!1:([needle.state,this.spare]=[spare,state],!0)}positions(i,s){
let{heap,planes}=this,{shapes}=this.needles[i],nodes=Number(heap.integers(shapes.nodes,1)[0]);return heap.borrow(
()=>{let[u,slope2]=["u","slope"].map(name=>heap.put(readPlanes(heap,shapes,name,planes,nodes)));return findPositions(
heap,planes,nodes,[shapes.x,u,slope2],s)})}}}});function mark(steps2){let changes=0;return steps2.map(({depth,inputs},n)=>{n&&inputs.bevel.strength!==steps2[n-
1].inputs.bevel.strength&&(changes+=1);let alike={...inputs,bevel:{...inputs.bevel,strength:changes}};return{depth,
inputs:alike,text:JSON.stringify(alike)}})}function findWay(past2,path){let shared=0,alike=n=>past2[n]?.text===
path[n]?.text;for(;shared<past2.length&&shared<path.length&&alike(shared)&&same(past2[shared].depth,path[shared].
depth);)shared+=1;let[last2,rest]=[past2.at(-1),path.slice(shared)],left=past2.length-shared,begun=left>0&&rest.
length>0&&alike(shared),turned2=shared>0&&rest.length>0&&same(last2.depth,path[shared-1].depth);if(left===0||begun&&
left===1||!begun&&turned2)return rest;let from=begun?shared:shared-1;if(from<0)return null;let depth=(begun?Math.
min(past2[shared].depth,path[shared].depth):path[from].depth)-BACK;return depth>0?[{...path[from],depth},...path.
slice(from)]:null}function spanBands(planes){let sizes=new Float64Array(planes[0][0].length),scaled=planes.map(
heights2=>heights2.map(values=>{let sorted=values.slice().sort(),[low,middle,high]=[LOW,MIDDLE,HIGH].map(share=>quantile(
sorted,share));return values.forEach((value,i)=>{let scale=value<middle?middle-low:high-middle;scale>TINY&&(sizes[i]=
Math.max(sizes[i],Math.abs(value-middle)/scale))}),[middle,middle-low,high-middle]})),size3=sizes.sort()[Math.
min(Math.floor(LEVEL*sizes.length),sizes.length-1)];return scaled.map(points=>({low:points.map(([middle,below])=>middle-
size3*below),high:points.map(([middle,,above])=>middle+size3*above)}))}function quantile(sorted,share){let place2=share*
(sorted.length-1),below=Math.floor(place2);return sorted[below]+(place2-below)*((sorted[below+1]??sorted[below])-
sorted[below])}var POINTS,LOW,MIDDLE,HIGH,LEVEL,TINY,CHUNK,SAME,BACK,Band,same,init_band=__esm({"needlefit/vie\
wer/page/model/band.js"(){init_needle();POINTS=51,[LOW,MIDDLE,HIGH]=[.025,.5,.975],LEVEL=.95,TINY=1e-9,CHUNK=20,
SAME=1e-9,BACK=1e-6,Band=class{kernel;model;draws;values;chunks;rays;points;constructor(kernel,model,draws){let chunks=Array.
from({length:Math.ceil(draws.sets/CHUNK)},(_,n)=>({numbers:Array.from({length:Math.min(CHUNK,draws.sets-n*CHUNK)},
(_2,i)=>n*CHUNK+i)})),typed=["mu","law","strength"].map(name=>[name,Float64Array.from(draws[name])]),values={sets:draws.
sets,...Object.fromEntries(typed)};Object.assign(this,{kernel,model,draws,values,chunks,rays:0,points:[]})}async compute(steps2,planes,cancelled,pause2){
let path=mark(steps2),{depth}=path.at(-1);if(!(depth>0))return null;let rays=path.length+Math.ceil(depth/this.
model.spacing)+2;if(rays>this.rays||planes!==this.batch.planes){this.rays=2*rays,this.batch=await SessionBatch.
begin(this.kernel,this.model,this.values,this.rays,planes);for(let chunk of this.chunks)chunk.path=null}for(let chunk of this.
chunks)if(this.#move(chunk,path),await pause2(),cancelled())return null;let found=this.points.filter(one=>one);
if(!found.length)return null;let along=axis=>Array.from({length:POINTS},(_,k)=>Float64Array.from(found,one=>one[(1+
planes)*k+axis])),[y,z]=spanBands(planes>1?[along(1),along(2)]:[along(1)]);return{x:along(0).map(values=>quantile(
values.sort(),MIDDLE)),...y,z:z??null,failed:this.values.sets-found.length}}#move(chunk,path){let{batch,points}=this,
way=chunk.path&&findWay(chunk.path,path);if(!way||way[0]?.depth<=chunk.failed){way=path,chunk.failed=-1/0;for(let i of chunk.
numbers)batch.restart(i),points[i]=[]}chunk.path=path;let{depth}=path.at(-1),s=Float64Array.from({length:POINTS},
(_,k)=>k===POINTS-1?depth:depth*k/(POINTS-1));way.forEach((step,n)=>{batch.hold(step.inputs);for(let i of chunk.
numbers){if(!points[i])continue;batch.go(i,step.depth)?n===way.length-1&&(points[i]=batch.positions(i,s)):[points[i],
chunk.failed]=[null,Math.max(chunk.failed,step.depth)]}})}};same=(depth,other)=>Math.abs(depth-other)<=SAME}});var CHUNK2,SAME2,TipForces,init_tip_forces=__esm({"needlefit/viewer/page/model/tip_forces.js"(){init_needle();
init_band();CHUNK2=20,SAME2=1e-9,TipForces=class{kernel;model;path;points;constructor(kernel){Object.assign(this,
{kernel,model:"",path:null,points:[]})}async compute(model,steps2,cancelled,pause2){let path=steps2.map(one=>({
...one,text:JSON.stringify(one.inputs)})),same3=this.model===JSON.stringify(model),way=this.path&&same3&&findWay(
this.path,path);way||await this.#begin(model,steps2[0].inputs),way||=path,this.path=null;let reached=0;for(let{
depth,inputs}of way){depth<this.session.depth-SAME2&&(this.points=this.points.filter(one=>one.depth<=depth+SAME2));
for(let stop of this.#listStops(depth)){if(this.session.go(stop,inputs),this.session.failed)return this.#read();
if(this.#add(),reached+=1,!(reached%CHUNK2)&&(await pause2(),cancelled()))return null}this.session.go(depth,inputs)}
return this.path=path,this.#read()}async#begin(model,inputs){this.session?this.session.again(model,[{depth:0,inputs}]):
this.session=await Session.begin(this.kernel,model,inputs),[this.model,this.points]=[JSON.stringify(model),[]],
this.#add()}#listStops(depth){let{model:{firstCell,spacing},depth:from}=this.session,first=from<firstCell-SAME2?
0:Math.floor((from-firstCell+SAME2)/spacing)+1,count=Math.floor((depth-firstCell+SAME2)/spacing)+1-first;return Array.
from({length:Math.max(count,0)},(_,n)=>Math.min(firstCell+(first+n)*spacing,depth))}#add(){let{session}=this;this.
points.push({depth:session.depth,force:session.forces().tipForce})}#read(){return{x:this.points.map(({depth})=>depth),
y:this.points.map(({force})=>force)}}}}});var band_worker_exports={};async function work(){busy=!0;let order=null;for(;order!==newest&&newest.steps;){order=
newest;let{kernel,model,draws,steps:steps2,planes,id}=order,isOld=()=>newest!==order&&(newest.draws!==draws||performance.
now()-done<STALE);tipForces??=new TipForces(kernel);let forces=await tipForces.compute(model,steps2,isOld,pause);
if(!isOld()){if(postMessage({id,forces}),draws){band?.draws!==draws&&(band=new Band(kernel,model,draws));let found=await band.
compute(steps2,planes,isOld,pause);if(isOld())continue;postMessage({id,band:found})}done=performance.now()}}busy=
!1}var STALE,newest,band,tipForces,busy,done,channel,waiting,pause,init_band_worker=__esm({"needlefit/viewer/p\
age/model/band_worker.js"(){init_band();init_tip_forces();STALE=100,newest={},[band,tipForces]=[null,null],busy=
!1,done=0,channel=new MessageChannel,waiting=[];channel.port1.onmessage=()=>waiting.shift()();pause=()=>new Promise(
resume=>{waiting.push(resume),channel.port2.postMessage(null)});onmessage=({data})=>{newest={...newest,...data},
busy||work()}}});function write(id,text){let place2=typeof id=="string"?part(id):id;place2.textContent!==text&&(place2.textContent=
text)}function element(tag,properties={},...contents){let made2=Object.assign(document.createElement(tag),properties);
return made2.append(...contents.flat()),made2}function button(text,act,properties={}){let made2=element("butto\
n",{type:"button",...properties},text);return press(made2,act),made2}function say(words){part("announced").textContent=
"",requestAnimationFrame(()=>part("announced").textContent=words)}function hand(blob,name){let link=element("a",
{href:URL.createObjectURL(blob),download:name});link.click(),setTimeout(()=>URL.revokeObjectURL(link.href),1e4)}
function colour(name){let both=getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).match(
/#\w+/g)??[""];return both[isDark()?both.length-1:0]}var part,press,entry,dark,paper,isDark,usePaper,onScheme,
init_dom=__esm({"needlefit/viewer/page/dom.js"(){part=id=>document.getElementById(id);press=(id,act)=>(typeof id==
"string"?part(id):id).addEventListener("click",act);entry=(term,value)=>element("div",{},element("dt",{},term),
element("dd",{},value));dark=matchMedia("(prefers-color-scheme: dark)"),paper=!1,isDark=()=>dark.matches&&!paper,
usePaper=on=>paper=on,onScheme=act=>dark.addEventListener("change",act)}});function checkChange([name,item,value],rules){let known=rules.inputs[name];if(!known)throw new ModelError(`the\
re is no input ${name}`,`one of ${Object.keys(rules.inputs).join(", ")}`);let counted2=Number.isInteger(item)&&
item>=1&&item<=(known.item==="guide"?rules.max_guide:1/0);if(known.item?!counted2:item!==null)throw new ModelError(
`${name} has item ${item}`,`the number of a ${known.item}`);let lengths=name.endsWith("_mm"),most=lengths?rules.
max_mm:rules.max,finite=Math.abs(value)<=most,{least,above,upto,below,values}=known;if(!(finite&&!(value<least||
value<=above||value>upto||value>=below)&&(!values||values.includes(value)))){let expected=finite||known.expected&&
!lengths?known.expected:`a finite number, at most ${most}${lengths?" mm":""}`;throw new ModelError(`${nameOf(name)}${item===
null?"":` of ${known.item} ${item}`} is ${written(name,value)}`,expected)}}function written(name,value){if(name===
"mu_pa")return Math.abs(value)<1e6?`${significant(value*.001)} kPa`:`${significant(value*1e-6)} MPa`;if(name.endsWith(
"slope"))return`${(Math.atan(value)*DEGREES).toFixed(1)}°`;let[,unit]=UNITS.find(([end])=>name.endsWith(end))??
["",""];return`${significant(value)}${unit}`}function guideNumber(name,names){let at=names.indexOf(name);return at<
0?Number(name.replace("guide ","")):at+1}function applyChanges(step,changes,names,stands){let values=new Map(changes.
map(([name,item,value])=>[`${name} ${item??""}`,value])),of=(name,now2)=>values.get(`${name} `)??now2,held=step.
controls,{tip}=held;if(of("tip_held",1)===0)tip=null;else if(tip||values.has("tip_held ")||values.has("tip_y_m\
m ")){let[y,z]=tip?[tip.y,tip.z??0]:stands;tip={y:of("tip_y_mm",y),slope:of("tip_slope",tip?tip.slope:null),z}}
let[angle2,side]=[of("cut_angle_deg",null),of("bevel_side",null)],roll2=side===null?rollOf(step.bevel):side>0?
0:180;return{depth:of("depth_mm",step.depth),bevel:{...toSide(of("bevel_roll_deg",roll2)),offset:of("bevel_off\
set_mm",step.bevel.offset),cutAngle:angle2===null?step.bevel.cutAngle:angle2*RADIANS},controls:{baseY:of("base\
_y_mm",held.baseY),baseSlope:of("base_slope",held.baseSlope),stageSlope:held.stageSlope,guides:applyToGuides(held.
guides,changes,names),tip}}}function applyToGuides(guides2,changes,names){let moves=new Map;for(let[name,item,
value]of changes)item===null||!name.startsWith("guide_")||(moves.has(item)||moves.set(item,{}),moves.get(item)[name.
slice(6)]=value);if(!moves.size)return guides2;let now2=new Map(guides2.map(guide=>[guide.name,guide]));for(let[
item,moved2]of[...moves].sort(([one],[other])=>one-other)){let name=names[item-1]??`guide ${item}`;if(moved2.engaged===
0){now2.delete(name);continue}let guide=now2.get(name);if(!guide){if(moved2.x_mm===void 0||moved2.y_mm===void 0)
throw new ModelError(`there is no ${name}`,"guide_x_mm and guide_y_mm together, which make a guide","add it be\
fore it is moved");guide={slope:0,name}}let slope2=moved2.slope??guide.slope;moved2.turns_freely!==void 0&&(slope2=
moved2.turns_freely?null:moved2.slope??guide.slope??0),now2.set(name,{name,x:moved2.x_mm??guide.x,y:moved2.y_mm??
guide.y,slope:slope2})}let ordered=[...now2.values()].sort((one,other)=>one.x-other.x),twice=ordered.find((guide,i)=>guide.
x===ordered[i+1]?.x);if(twice)throw new ModelError(`two guides stand at the same x = ${twice.x} mm`,"guides at\
 different x","move one of them, or leave it out");return ordered}function findChanges(step,now2,names){let[wanted,
held]=[step.controls,now2.controls],changes=[step.bevel.roll||now2.bevel.roll?["bevel_roll_deg",rollOf(step.bevel),
rollOf(now2.bevel)]:["bevel_side",step.bevel.side,now2.bevel.side],["bevel_offset_mm",step.bevel.offset,now2.bevel.
offset],["cut_angle_deg",step.bevel.cutAngle*DEGREES,now2.bevel.cutAngle*DEGREES],["base_y_mm",wanted.baseY,held.
baseY],["base_slope",wanted.baseSlope,held.baseSlope]].filter(([,value,before2])=>value!==before2).map(([name,
value])=>[name,null,value]);for(let{name}of held.guides)wanted.guides.some(guide=>guide.name===name)||changes.
push(["guide_engaged",guideNumber(name,names),0]);for(let{name,x,y,slope:slope2}of wanted.guides){if(held.guides.
some(guide=>guide.x===x&&guide.y===y&&guide.slope===slope2))continue;let item=guideNumber(name,names);changes.
push(["guide_x_mm",item,x],["guide_y_mm",item,y],["guide_turns_freely",item,slope2===null?1:0]),slope2!==null&&
changes.push(["guide_slope",item,slope2])}return!wanted.tip&&held.tip?changes.push(["tip_held",null,0]):wanted.
tip&&!(held.tip&&wanted.tip.y===held.tip.y&&wanted.tip.slope===held.tip.slope)&&(changes.push(["tip_y_mm",null,
wanted.tip.y]),wanted.tip.slope!==null&&changes.push(["tip_slope",null,wanted.tip.slope])),changes}function toInputs({
bevel,controls},pathAngle){if((pathAngle?bevel.offset:bevel.cutAngle)!==0)throw new ModelError("the strength o\
f the bevel is that of the other rule of advance",pathAngle?"a cut angle alone":"an offset alone");let{baseY,baseSlope,
stageSlope,guides:guides2,tip}=controls;return{bevel:{side:bevel.side,roll:bevel.roll,strength:pathAngle?bevel.
cutAngle:bevel.offset},base:{y:baseY,slope:baseSlope,stageSlope},guides:guides2,tip}}function toStep({depth,inputs},pathAngle){
let{bevel,base,guides:guides2,tip}=inputs,[offset,cutAngle]=pathAngle?[0,bevel.strength]:[bevel.strength,0];return{
depth,bevel:{side:bevel.side,roll:bevel.roll,offset,cutAngle},controls:{baseY:base.y,baseSlope:base.slope,stageSlope:base.
stageSlope,guides:guides2,tip}}}function listSteps({simulation:{steps:steps2},guide_names:names}){return steps2.
map((step,i)=>[...findChanges(step,steps2[i-1]??steps2[0],names),["depth_mm",null,step.depth]])}var ModelError,
RADIANS,DEGREES,UNITS,nameOf,significant,rollOf,toSide,wrap,turnOver,init_inputs=__esm({"needlefit/viewer/page\
/model/inputs.js"(){ModelError=class extends Error{constructor(what,expected,fix){super(what),Object.assign(this,
{what,expected,fix})}},RADIANS=Math.PI/180,DEGREES=180/Math.PI,UNITS=[["_mm"," mm"],["_deg","°"],["_pa"," Pa"]];
nameOf=name=>name.replace(/_(mm|deg|pa)$/,"").replaceAll("_"," ");significant=value=>Number(value.toPrecision(
6));rollOf=({side,roll:roll2})=>roll2+(side>0?0:180),toSide=roll2=>Math.abs(roll2%360)===180?{side:-1,roll:roll2-
180}:{side:1,roll:roll2},wrap=roll2=>180-((180-roll2)%360+360)%360,turnOver=roll2=>roll2%180?["bevel_roll_deg",
null,wrap(roll2+180)]:["bevel_side",null,roll2%360?1:-1]}});function signed(value,digits2){let size3=Math.abs(value).toFixed(digits2);return Number(size3)===0?size3:(value<
0?"−":"+")+size3}function modulusLike(one){let[unit,pascals]=one<1e6?["kPa",1e3]:["MPa",1e6];return{unit,write:(value,digits2=4)=>brief(
value/pascals,digits2),read:text=>Number(text)*pascals}}function modulus(value){let{unit,write:write2}=modulusLike(
value);return`${write2(value,3)} ${unit}`}function heightAt({x:xs,y:ys},x){let after=xs.findIndex(one=>one>=x);
if(after<=0)return after===0?ys[0]:ys.at(-1);let share=(x-xs[after-1])/(xs[after]-xs[after-1]);return ys[after-
1]+share*(ys[after]-ys[after-1])}function smooth(x,load3,reach){let sums=[0];for(let i=1;i<x.length;i+=1)sums.
push(sums[i-1]+(load3[i]+load3[i-1])/2*(x[i]-x[i-1]));let sumTo=(at,i)=>{if(i===0)return 0;if(i===x.length)return sums.
at(-1);let part2=(at-x[i-1])/(x[i]-x[i-1]||1);return sums[i-1]+(load3[i-1]+part2*(load3[i]-load3[i-1])/2)*(at-
x[i-1])},[from,to]=[0,0];return x.map(at=>{let half=Math.min(reach,at-x[0],x.at(-1)-at);if(half<=0)return load3[at===
x[0]?0:x.length-1];for(;from<x.length&&x[from]<=at-half;)from+=1;for(;to<x.length&&x[to]<=at+half;)to+=1;return(sumTo(
at+half,to)-sumTo(at-half,from))/(2*half)})}function roundStep(value){let decade=10**Math.floor(Math.log10(value)),
times=value/decade;return decade*(times>=5?5:times>=2?2:1)}function strengthOf(values){let about="cut_angle_de\
g"in values?ANGLE:OFFSET,[here,throughout]=INPUTS[about.key];return{...about,here,throughout,value:values[about.
key]}}function isChanged({bevel,layers},{fitted:fitted2}){let{key,value}=strengthOf(fitted2);return!near(bevel[key],
value)||layers.some((layer,i)=>Object.entries(fitted2.layers[i]).some(([name,one])=>!near(layer[name],one)))}function isSteered(state,scene){
let{steps:steps2}=scene.simulation,{bevel,controls}=steps2.find(({depth})=>depth>=state.depth_mm-1e-6)??steps2.
at(-1),{base,guides:guides2,tip}=state;return isChanged(state,scene)||state.bevel.roll_deg!==wrap(rollOf(bevel))||
tip.held!==!!controls.tip||base.input_y!==controls.baseY||base.input_slope!==controls.baseSlope||guides2.length!==
controls.guides.length||guides2.some(({x,y},i)=>x!==controls.guides[i].x||y!==controls.guides[i].y)}var writeError,
listErrors,brief,counted,toDegrees,degrees,slope,numbered,shortName,OFFSET,ANGLE,INPUTS,ROLL,ROLL_FIELD,describeRoll,
near,predictionOf,init_quantities=__esm({"needlefit/viewer/page/quantities.js"(){init_inputs();writeError=(value,unit)=>value===
null?"–":unit==="%"?brief(value,3):value.toFixed(3),listErrors=(errors,{metrics})=>metrics.map(([name,label2,
unit])=>`${label2} ${writeError(errors[name],unit)} ${unit}`);brief=(value,digits2=4)=>String(Number(Number(value).
toPrecision(digits2))),counted=(count,one)=>`${count} ${one}${count===1?"":"s"}`;toDegrees=rotation=>rotation*
180/Math.PI,degrees=slope2=>Math.atan(slope2)*180/Math.PI,slope=angle2=>Math.tan(Math.min(Math.max(angle2,-90),
90)*Math.PI/180);numbered=item=>`guide ${item}`,shortName=({item,name})=>name&&name!==numbered(item)?name:String(
item),OFFSET={key:"offset_mm",symbol:"b",unit:"mm",digits:3,step:.005},ANGLE={key:"cut_angle_deg",symbol:"θ",
unit:"°",digits:2,step:.1},INPUTS={offset_mm:["bevel_offset_mm","offset_throughout_mm"],cut_angle_deg:["cut_a\
ngle_deg","cut_angle_throughout_deg"]};ROLL=10,ROLL_FIELD={name:"roll",symbol:"roll",unit:"°",step:ROLL,limits:[
-180,180],write:value=>brief(value,6)},describeRoll=({roll_deg:roll2})=>roll2%180?`roll ${brief(roll2).replace(
"-","−")}°`:roll2?"−y":"+y",near=(one,other)=>Math.abs(one-other)<=1e-9*Math.abs(other);predictionOf=(state,scene)=>Math.
abs(state.depth_mm-scene.depth_mm)<1e-6&&!isSteered(state,scene)?scene.measured?.prediction??null:null}});function listen(kind,hear2){listeners.has(kind)||listeners.set(kind,[]),listeners.get(kind).push(hear2)}function publish(kind,message){
for(let hear2 of listeners.get(kind)??[])hear2(message)}function take(message){message.kind==="scene"?Object.assign(
now,{scene:message,band:null}):message.kind==="band"?now.band=message.x.length?message:null:now[message.kind]=
message,publish(message.kind,message)}var now,listeners,tipForce,init_store=__esm({"needlefit/viewer/page/stor\
e.js"(){now={data:null,needle:null,steered:null,replay:null,scene:null,state:null,band:null,pinned:null,marked:null,
forces:{x:[],y:[]},view:null,labels:[]};Object.assign(window,{needlefit:now});listeners=new Map;tipForce=()=>now.
forces.y.at(-1)??null}});function takeChange(){let was=changed;return changed=!1,was}function touch(){changed=!0,publish("redraw")}function resize(width,height){
view.low=height<LOW_PICTURE,view.box={left:GUTTER.left,top:GUTTER.top,width:Math.max(width-GUTTER.left-GUTTER.
right,10),height:Math.max(height-GUTTER.top-(view.low?LOW_BOTTOM:GUTTER.bottom),10)},view.held||fit(view.fit)}
function fit(which){if(view.fit=which,touch(),!now.scene||!now.state||!which)return;if(which==="tip"){let{x,y}=now.
state.tip;return Object.assign(view,{scale:limited(view.box.width/TIP_WINDOW),magnified:1,x,y})}let[low,high,before2,
after]=which==="whole"?[-now.scene.length_mm,deepest()+4,Math.min(74,.1*view.box.width+20),34]:[0,1.04*deepest(),
Math.min(84,.2*view.box.width),34],room=view.box.width-before2-after,[bottom,top]=heights(which),[along,across]=[
room/(high-low),roomAcross()/(top-bottom)];view.scale=limited(Math.min(along,across));let least=LEAST_SPAN*deepest(),
times=roomAcross()/view.scale/Math.max(top-bottom,least);view.magnified=MAGNIFICATIONS.filter(one=>one<=times).
at(-1)??1,view.x=(low+high)/2+(after-before2)/(2*view.scale),view.y=(bottom+top)/2}function deepest(){let{depth_mm:depth,
boundaries_mm:tops,measured:measured2}=now.scene,goals=goalCircles().map(([x,,radius])=>x+radius);return Math.
max(depth,now.state.depth_mm,(tops.at(-1)??0)+5,measured2?.depth_mm??0,...goals)}function goalCircles(){let{plan}=now.
scene;return plan?[[...plan.target,plan.radius],...plan.obstacles]:[]}function heights(which){let{x,y}=now.state,
seen=which==="whole"?y:y.filter((_,i)=>x[i]>=0),goals=goalCircles().flatMap(([,y2,radius])=>[y2-radius,y2+radius]),
band2=[...now.band?.low??[],...now.band?.high??[]].filter(Number.isFinite),all2=[...seen,...now.scene.measured?.
y??[],...now.pinned?now.pinned.y.filter((_,i)=>which==="whole"||now.pinned.x[i]>=0):[],...goals,...band2,0];return[
Math.min(...all2),Math.max(...all2)]}function sees(x,y){let{left,top,width,height}=view.box,[px,py]=[toPx(x)-left,
toPy(y)-top];return px>=0&&px<=width&&py>=0&&py<=height}function follow(){if(view.held)return;if(view.fit&&view.
fit!=="tip"){let[bottom,top]=heights(view.fit),px=view.scale*view.magnified,out=Math.max(top-view.y,view.y-bottom)*
px>roomAcross()/2+1||!seesTip(),low=(top-bottom)*px<LOW2*roomAcross();(out||low&&view.magnified<MAGNIFICATIONS.
at(-1))&&fit(view.fit);return}if(view.fit!=="tip")return;let{x,y}=now.state.tip,across=(x-view.x)*view.scale/view.
box.width,up2=(y-view.y)*view.scale*view.magnified/view.box.height;Math.abs(across)<EDGE&&Math.abs(up2)<EDGE||
(view.x=x+Math.sign(across)*AHEAD*view.box.width/view.scale,view.y=y,touch())}function zoom(factor,px=toPx(view.
x),py=toPy(view.y)){let[x,y]=[fromPx(px),fromPy(py)];view.scale=limited(view.scale*factor),view.x+=x-fromPx(px),
view.y+=y-fromPy(py),view.fit!=="tip"&&(view.fit=null),touch()}function pan(px,py){view.x-=px/view.scale,view.
y+=py/(view.scale*view.magnified),view.fit=null,touch()}function hold(on){view.held!==on&&(view.held=on,!on&&now.
state&&follow())}var GUTTER,LOW_PICTURE,LOW_BOTTOM,MAGNIFICATIONS,ROOM,LEAST_SPAN,LOW2,SCALES,EDGE,AHEAD,TIP_WINDOW,
view,changed,toPx,toPy,fromPx,fromPy,roomAcross,seesTip,limited,init_view=__esm({"needlefit/viewer/page/view.j\
s"(){init_store();GUTTER={left:56,right:10,top:50,bottom:40},LOW_PICTURE=260,LOW_BOTTOM=24,MAGNIFICATIONS=[1,1.5,
2,3,4,5,6,8,10,12,15,20,30,50],ROOM=56,LEAST_SPAN=.01,LOW2=.45,SCALES=[.5,400],[EDGE,AHEAD]=[.3,.2],TIP_WINDOW=
45,view={x:0,y:0,scale:5,magnified:1,held:!1,fit:null,low:!1,box:{left:0,top:0,width:1,height:1}};Object.assign(
now,{view});changed=!0;toPx=x=>view.box.left+view.box.width/2+(x-view.x)*view.scale,toPy=y=>view.box.top+view.
box.height/2-(y-view.y)*view.scale*view.magnified,fromPx=px=>view.x+(px-view.box.left-view.box.width/2)/view.scale,
fromPy=py=>view.y-(py-view.box.top-view.box.height/2)/(view.scale*view.magnified);roomAcross=()=>view.box.height-
2*Math.min(ROOM,.2*view.box.height);seesTip=()=>sees(now.state.tip.x,now.state.tip.y);limited=scale=>Math.min(
Math.max(scale,SCALES[0]),SCALES[1]);listen("band",follow)}});function readPalette(){for(let name of NAMES)palette[name]=colour(name)}function shades(layers){let stiffness=layers.
map(({mu_pa:mu})=>Math.log10(mu)),least=Math.min(...stiffness),decades=Math.max(Math.max(...stiffness)-least,1);
return stiffness.map(one=>between(palette.soft,palette.stiff,(one-least)/decades))}function between(one,other,share){
return`rgb(${[1,3,5].map(at=>{let[low,high]=[one,other].map(colour2=>parseInt(colour2.slice(at,at+2),16));return Math.
round(low+share*(high-low))}).join(" ")})`}function faintly(context3,opacity,draw4){context3.globalAlpha=opacity,
draw4(),context3.globalAlpha=1}function stroke(context3,colour2,width){context3.strokeStyle=colour2,context3.lineWidth=
width,context3.stroke()}function trace(context3,...lines){context3.beginPath();for(let places of lines)places.
forEach(([px,py],i)=>i?context3.lineTo(px,py):context3.moveTo(px,py))}function arrow(context3,[px,py],length,colour2){
let[end,head]=[py-length,8*Math.sign(length)];segments(context3,[[[px,py],[px,end+head]]],colour2,2.5),polygon(
context3,[[px-5,end+head],[px,end],[px+5,end+head]],colour2)}function line(context3,x,y,colour2,width,dash=[]){
context3.setLineDash(dash),trace(context3,placesOf(x,y)),stroke(context3,colour2,width),context3.setLineDash([])}
function fillBetween(context3,x,low,high,colour2){trace(context3,[...placesOf(x,low),...placesOf(x,high).reverse()]),
context3.closePath(),context3.fillStyle=colour2,context3.fill()}function polygon(context3,corners,colour2){context3.
fillStyle=colour2,context3.beginPath();for(let corner of corners)context3.lineTo(...corner);context3.fill()}function segments(context3,pairs,colour2,width){
context3.beginPath();for(let[from,to]of pairs)context3.moveTo(...from),context3.lineTo(...to);stroke(context3,
colour2,width)}function ring(context3,px,py,radius,edge,inside){context3.beginPath(),context3.arc(px,py,radius,
0,2*Math.PI),context3.fillStyle=inside,context3.fill(),stroke(context3,edge,2)}function turned(context3,px,py,angle2,draw4){
context3.save(),context3.translate(px,py),context3.rotate(-angle2),draw4(),context3.restore()}function setFont(context3,font,align="\
center",baseline="middle"){context3.font=FONTS[font],context3.textAlign=align,context3.textBaseline=baseline}function label(context3,text,px,py,colour2=palette.
label){context3.strokeStyle=palette.halo,context3.lineWidth=4,context3.strokeText(text,px,py),context3.fillStyle=
colour2,context3.fillText(text,px,py)}function clearBoxes(){[boxes,avoided]=[[],[]],now.labels=boxes}function avoid(places){
for(let[px,py]of places){let[left,top]=avoided.at(-1)??[-1/0,0];Math.hypot(px-4-left,py-4-top)>8&&avoided.push(
[px-4,py-4,8,8])}}function labelFree(context3,text,places,colour2){let{left,top,width,height}=view.box,wide=context3.
measureText(text).width+6,within2=(value,low,high)=>Math.max(low,Math.min(value,high)),free=places.map(([px,py])=>[
within2(px-wide/2,left+2,left+width-wide-2),within2(py-LINE/2,top+2,top+height-LINE-2),wide,LINE]).filter(isFree),
box2=free.find(one=>!avoided.some(other=>overlap(one,other)))??free[0];box2&&(boxes.push(box2),context3.textAlign=
"center",context3.textBaseline="middle",label(context3,text,box2[0]+wide/2,box2[1]+LINE/2,colour2))}function labelBeside(context3,text,sides,colour2){
setFont(context3,"strong");let half=context3.measureText(text).width/2,curves=sides.map(([points,away])=>[placesOf(
...points),away]);for(let[places]of curves)avoid(places);let beside=SHARES.flatMap(share=>curves.flatMap(([places,
away])=>{let[px,py]=places[Math.round(share*(places.length-1))];return[0,-half,half].map(aside=>[px+aside,py+away])}));
labelFree(context3,text,beside,colour2)}var NAMES,FONTS,palette,placesOf,cross,LINE,boxes,avoided,overlap,isFree,
reserve,SHARES,init_strokes=__esm({"needlefit/viewer/page/painters/strokes.js"(){init_dom();init_store();init_view();
NAMES=["air","gutter","ink","quiet","edge","needle","points","path","tip","guide","load","measured","band","gh\
ost","plan","gap","bad","halo","soft","stiff","label","accent"],FONTS={small:"11px system-ui, sans-serif",plain:"\
12px system-ui, sans-serif",strong:"600 12px system-ui, sans-serif"},palette={};placesOf=(x,y)=>x.map((one,i)=>[
toPx(one),toPy(y[i])]);cross=(px,py,arm,oblique=!1)=>(oblique?[[arm,arm],[arm,-arm]]:[[arm,0],[0,arm]]).map(([
dx,dy])=>[[px-dx,py-dy],[px+dx,py+dy]]);LINE=16,[boxes,avoided]=[[],[]];overlap=([x,y,w,h],[x2,y2,w2,h2])=>x<x2+
w2&&x2<x+w&&y<y2+h2&&y2<y+h,isFree=box2=>!boxes.some(one=>overlap(one,box2)),reserve=(...box2)=>boxes.push(box2);
SHARES=[1,.8,.6,.4]}});function paintTissue(context3){let{left,top,width,height}=view.box;context3.fillStyle=palette.air,context3.fillRect(
left,top,width,height);let layers=listLayers();for(let{from,to,shade}of layers)context3.fillStyle=shade,context3.
fillRect(from,top,to-from,height);for(let{from,number,top:edge}of layers)edge<left||(context3.fillStyle=number===
1?palette.ink:palette.edge,context3.fillRect(Math.round(from)-.5,top,number===1?1.5:1,height));let axis=Math.round(
toPy(0))+.5;context3.setLineDash([5,4]),segments(context3,[[[left,axis],[left+width,axis]]],palette.quiet,1),context3.
setLineDash([])}function listLayers(){let{boundaries_mm:tops,layer_names:names}=now.scene,{left,width}=view.box,
depths=[0,...tops,1/0];return shades(now.state.layers).map((shade,i)=>({shade,number:i+1,name:names[i]||`layer\
 ${i+1}`,mu:now.state.layers[i].mu_pa,top:toPx(depths[i]),from:Math.max(toPx(depths[i]),left),to:Math.min(toPx(
depths[i+1]),left+width)})).filter(({from,to})=>to>from)}function paintNames(context3){let{left,top}=view.box,
layers=listLayers().map(layer=>({...layer,middle:(layer.from+layer.to)/2,modulus:modulus(layer.mu)})),row=write2=>layers.
map(layer=>({px:layer.middle,text:write2(layer)})),fits2=texts=>texts.every(({px,text},i)=>{let half=context3.
measureText(text).width/2,[before2,after]=[texts[i-1],texts[i+1]].map(other=>other?context3.measureText(other.
text).width/2+APART:0);return(!i||px-half>=texts[i-1].px+before2)&&(!texts[i+1]||px+half<=texts[i+1].px-after)});
setFont(context3,"plain");let whole=row(one=>`μ ${one.modulus}`),names=row(one=>one.name),called=fits2(names)?
names:row(one=>String(one.number)),part2=(n,before2="")=>row(one=>before2+one.modulus.split(" ")[n]),values=fits2(
part2(0,"μ "))?part2(0,"μ "):part2(0),rows=fits2(whole)?[called,whole]:[called,values,part2(1)];rows.length>
2&&setFont(context3,"small"),rows.forEach((texts,n)=>{let end=-1/0;for(let{px,text}of texts){let half=context3.
measureText(text).width/2;px-half<end+2||(context3.fillText(text,px,top+(rows.length>2?ROWS:TWO_ROWS)[n]),end=
px+half)}});let skin=toPx(0);skin<=left+40||skin>left+view.box.width||(context3.textAlign="right",context3.fillText(
"skin",skin-4,top-11))}function paintFrame(context3,name){let{left,top,width,height}=view.box,bottom=top+height;
context3.lineWidth=1,context3.strokeStyle=palette.quiet,context3.strokeRect(left-.5,top-.5,width+1,height+1),context3.
fillStyle=palette.label,setFont(context3,"small","right");let scale=view.scale*view.magnified,across=ticks(fromPy(
bottom),fromPy(top),scale,height).map(y=>[y,Math.round(toPy(y))+.5]);segments(context3,across.map(([,py])=>[[left-
TICK,py],[left,py]]),palette.quiet,1);for(let[y,py]of across)context3.fillText(written2(y),left-TICK-2,py);context3.
textAlign="center",turned(context3,11,top+height/2,QUARTER,()=>context3.fillText(name,0,0))}function paintAxes(context3){
let{left,top,width,height}=view.box,bottom=top+height;setFont(context3,"small"),paintFrame(context3,nameAcross(
context3,height)),paintNames(context3),setFont(context3,"small","center","top");let along=ticks(fromPx(left),fromPx(
left+width),view.scale,width).map(x=>[x,Math.round(toPx(x))+.5]);segments(context3,along.map(([,px])=>[[px,bottom],
[px,bottom+TICK]]),palette.quiet,1);let end=left+width-(view.low?context3.measureText(IN_ROW).width+APART:0);for(let[
x,px]of along)(px<end-APART||!view.low)&&context3.fillText(written2(x),px,bottom+TICK+2);view.low?context3.fillText(
IN_ROW,(end+APART+left+width)/2,bottom+TICK+2):context3.fillText("x along the entry (mm)",left+width/2,bottom+
26)}function ticks(low,high,scale,length){let step=roundStep(2.5*Math.min(TICKS_APART,length/6)/scale),first=Math.
ceil(low/step);return Array.from({length:Math.max(Math.floor(high/step)-first+1,0)},(_,i)=>(first+i)*step)}function nameAcross(context3,room){
if(view.magnified===1)return"y (mm)";let long=`y (mm), drawn ${view.magnified}× as large as x`;return context3.
measureText(long).width<room?long:`y (mm), drawn ${view.magnified}×`}var APART,ROWS,TWO_ROWS,TICK,TICKS_APART,
QUARTER,IN_ROW,written2,init_background=__esm({"needlefit/viewer/page/painters/background.js"(){init_quantities();
init_store();init_view();init_strokes();APART=8,ROWS=[-34,-20,-6],TWO_ROWS=[-27,-11],TICK=5,TICKS_APART=48,QUARTER=
Math.PI/2,IN_ROW="x (mm)";written2=value=>brief(value,6).replace("-","−")}});function basePlace({base}){let[px,py,angle2]=[toPx(base.x),toPy(base.y),angleOf(Math.tan(base.rotation))];return{
place:[px,py],turn:[px-ARM.base*Math.cos(angle2),py+ARM.base*Math.sin(angle2)],angle:angle2}}function guidePlace({
x,y,slope:slope2}){let[px,py,angle2]=[toPx(x),toPy(y),angleOf(slope2)];return{place:[px,py],turn:[px-ARM.guide*
Math.sin(angle2),py-ARM.guide*Math.cos(angle2)],angle:angle2}}function bevelPlace({tip,bevel}){let[px,py]=[toPx(
tip.x),toPy(tip.y)];return{tip:[px,py],turn:[px+AHEAD2,py-Math.cos(bevel.roll_deg*Math.PI/180)*ARM.bevel]}}function all(){
let{state}=now,base=basePlace(state),bevel=bevelPlace(state),handles=[{at:bevel.turn,cursor:"grab",drag:turnBevel(
state)},{at:bevel.tip,cursor:"ns-resize",drag:dragTip(state)}],add2=(at,cursor,drag2)=>handles.push({at,cursor,
drag:drag2});for(let guide of state.guides){let{place:place2,turn:turn2}=guidePlace(guide);guide.turns_freely||
add2(turn2,"grab",turnGuide(guide,place2)),add2(place2,"move",dragGuide(guide))}return add2(base.turn,"grab",turnBase(
state,base.place)),add2(base.place,"move",dragBase(state)),handles}function handleAt(px,py,kind="mouse"){if(!now.
state)return null;let[nearest,least]=[null,NEAR[kind]??NEAR.mouse];for(let handle of all()){let distance2=Math.
hypot(handle.at[0]-px,handle.at[1]-py);distance2<least&&([nearest,least]=[handle,distance2])}return nearest}function dragBase({
base,depth_mm:depth,guides:guides2}){let reach=now.scene.length_mm+Math.min(0,...guides2.map(({x})=>x))-.001,along=null;
return(from,to)=>{let[px,py]=[Math.abs(to[0]-from[0]),Math.abs(to[1]-from[1])];return px>BEGINS.along&&px>BEGINS.
times*py?along??=!0:py>BEGINS.across&&(along??=!1),along===null?[]:along?[["depth_mm",null,Math.min(Math.max(depth+
fromPx(to[0])-fromPx(from[0]),0),reach)]]:[["base_y_mm",null,base.input_y+rise(from,to)]]}}function turnBevel({
bevel}){let{side}=bevel;return(_,[,py])=>(bevelPlace(now.state).tip[1]-py)*side>-BEGINS.across?[]:(side=-side,
[turnOver(now.state.bevel.roll_deg)])}var ARM,AHEAD2,NEAR,BEGINS,angleOf,rise,dragTip,dragGuide,turnBase,turnGuide,
init_handles=__esm({"needlefit/viewer/page/handles.js"(){init_inputs();init_store();init_view();ARM={base:56,guide:42,
bevel:26},AHEAD2=16,NEAR={mouse:16,touch:28},BEGINS={across:3,along:8,times:2},angleOf=slope2=>Math.atan(slope2*
view.magnified);rise=(from,to)=>fromPy(to[1])-fromPy(from[1]);dragTip=({tip})=>(from,to)=>[["tip_y_mm",null,tip.
input_y+rise(from,to)]],dragGuide=({item,x,y})=>(from,to)=>[["guide_x_mm",item,x+fromPx(to[0])-fromPx(from[0])],
["guide_y_mm",item,y+rise(from,to)]],turnBase=({base},place2)=>(_,to)=>{let stage=base.rotation-base.input_slope,
along=(to[1]-place2[1])/Math.max(place2[0]-to[0],1)/view.magnified;return[["base_slope",null,Math.atan(along)-
stage]]},turnGuide=({item},place2)=>(_,to)=>{let[across,up2]=[to[0]-place2[0],place2[1]-to[1]];return[["guide_\
slope",item,-across/Math.max(up2,1)/view.magnified]]}}});function describeShaft({x,y,faults}){let outside=faults?.length>0,points=placesOf(x,y),tip=points.at(-1),shaft=points.
filter(one=>distance(one,tip)>BEVEL.length),last2=shaft.at(-1)??tip,share=1-BEVEL.length/(distance(last2,tip)||
1);return shaft.push(last2.map((from,i)=>from+share*(tip[i]-from))),{shaft,tip,outside,shown:outside?palette.bad:
palette.needle}}function paintNeedle(context3,state){let{shaft,tip,outside,shown:shown3}=describeShaft(state);
trace(context3,shaft),context3.lineCap="butt",context3.setLineDash(outside?[9,5]:[]),stroke(context3,shown3,LINE2),
context3.setLineDash([]);let[end,{half},{side}]=[shaft.at(-1),BEVEL,state.bevel],size3=distance(end,tip)||1,[dx,
dy]=tip.map((to,i)=>(to-end[i])/size3),at=([px,py],to)=>[px+to*dy*half,py-to*dx*half],[back,near2,point]=[at(end,
-side),at(end,side),at(tip,side)];polygon(context3,[back,near2,point],palette.needle),segments(context3,[[back,
point]],palette.tip,2)}function reserveNeedle(state){let{tip:[px,py],turn:turn2}=bevelPlace(state);reserve(turn2[0]-
9,turn2[1]-9,18,18);let arrow2=Array.from({length:5},(_,i)=>[px,py-i/6*arrowLength()]),{constraints:[along,across]}=state;
avoid([...placesOf(state.x,state.y),...placesOf(along,across),...arrow2])}function arrowLength(){let force=tipForce()??
0;return greatestForce.scene!==now.scene&&(greatestForce={scene:now.scene,newton:LEAST_FORCE}),greatestForce.newton=
Math.max(greatestForce.newton,Math.abs(force)),tallest()*force/greatestForce.newton}function paintTip(context3,state){
let{tip,turn:turn2}=bevelPlace(state);segments(context3,[[tip,turn2]],palette.tip,1.5),ring(context3,...turn2,
6,palette.air,palette.tip),setFont(context3,"small"),labelFree(context3,"bevel",[[turn2[0]+29,turn2[1]],[turn2[0],
turn2[1]-18*state.bevel.side]],palette.tip),state.tip.held&&ring(context3,...tip,11,palette.tip,"transparent")}
function paintTipForce(context3,{tip,z}){if(z)return;let[force,length]=[tipForce(),arrowLength()];if(Math.abs(
length)<SHORTEST)return;let[px,py]=[toPx(tip.x),toPy(tip.y)];arrow(context3,[px,py],length,palette.load),setFont(
context3,"small");let[end,half]=[py-length-9*Math.sign(length),py-length/2],places=[[px,end],[px-34,end],[px+30,
end],[px+30,half],[px-34,half],[px,end-14*Math.sign(length)]];labelFree(context3,`${brief(Math.abs(force),2)} \
N`,places,palette.load)}function paintMark(context3,{depth_mm:depth,depths,tip,tip_path:[x,y]},at){if(at>depth)
return;let read=places=>heightAt({x:[...depths,depth],y:places},at),[px,py]=[toPx(read([...x,tip.x])),toPy(read(
[...y,tip.y]))];ring(context3,px,py,5,palette.accent,palette.air)}function paintPoints(context3,{constraints:[
x,y]}){let half=Math.min(Math.max(CROSS.of*now.scene.spacing_mm*view.scale,CROSS.least),CROSS.most),crosses=placesOf(
x,y).flatMap(place2=>cross(...place2,half,!0));segments(context3,crosses,palette.points,half>2?1.4:1)}function paintBase(context3,state){
let{place:[px,py],turn:turn2,angle:angle2}=basePlace(state);segments(context3,[[[px,py-46],[px,py+46]]],palette.
quiet,2),segments(context3,[-46,46].map(to=>[[px-5,py+to],[px+5,py+to]]),palette.quiet,2),segments(context3,[[
[px,py],turn2]],palette.ink,1.5),turned(context3,px,py,angle2,()=>box(context3,-22,-7,26,14,4,palette.ink)),ring(
context3,...turn2,HANDLE,palette.ink,palette.air)}function box(context3,px,py,width,height,radius,fill){context3.
fillStyle=fill,context3.beginPath(),context3.roundRect(px,py,width,height,radius),context3.fill()}function paintGuides(context3,{
guides:guides2}){for(let guide of guides2){let{place:place2,turn:turn2,angle:angle2}=guidePlace(guide),clamps=!guide.
turns_freely;clamps&&segments(context3,[[place2,turn2]],palette.guide,1.5),turned(context3,...place2,angle2,()=>{
for(let to of[-1,1]){let from=GAP*to;clamps?box(context3,-13,Math.min(from,from+7*to),26,7,2,palette.guide):polygon(
context3,[[0,from],[-7,from+11*to],[7,from+11*to]],palette.guide)}}),clamps&&ring(context3,...turn2,HANDLE,palette.
guide,palette.air)}writeNames(context3,guides2)}function writeNames(context3,guides2){setFont(context3,"strong");
for(let guide of guides2.toSorted((one,other)=>one.item-other.item)){let[px,py]=[toPx(guide.x),toPy(guide.y)+27];
px<view.box.left||px>view.box.left+view.box.width||labelFree(context3,shortName(guide),[[px,py]],palette.guide)}}
function paintLoad(context3,{load:{x,y,n_per_mm:values}}){let planes=values.map(one=>smooth(x,one,now.scene.spacing_mm)),
load3=planes.length===1?planes[0]:planes[0].map((one,i)=>Math.hypot(one,planes[1][i])),greatest2=load3.reduce(
(most,one)=>Math.max(most,Math.abs(one)),0);if(greatest2<LEAST_LOAD||x.length<2)return;let height=greatest2*(perLoad??
0);(height>tallest()||height<Math.min(LOWEST,tallest()/3))&&(perLoad=.75*tallest()/(2*roundStep(greatest2)));let[
px,py]=[x.map(toPx),y.map(toPy)],[surface,ends]=[0,perLoad].map(scale=>px.map((x2,i)=>[x2,py[i]-load3[i]*scale])),
starts=load3.map((_,i)=>i).filter(i=>i===0||load3[i]*load3[i-1]<=0),edges=starts.map((from,n)=>{let to=starts[n+
1]??load3.length;return[surface[from],...ends.slice(from,to),surface[to-1]]});trace(context3,...edges.map((edge,n)=>[
...edge,...surface.slice(starts[n],starts[n+1]??load3.length).reverse()])),context3.fillStyle=palette.load,faintly(
context3,.32,()=>context3.fill()),trace(context3,...edges),stroke(context3,palette.load,1.25)}function paintKey(context3){
if(!perLoad)return;let size3=roundStep(30/perLoad),[px,height]=[7,size3*perLoad],py=view.box.top-6-height;segments(
context3,[[[px,py],[px,py+height]],...[py,py+height].map(end=>[[px-3,end],[px+3,end]])],palette.load,1.5),setFont(
context3,"small","left"),label(context3,`${brief(size3)} N/mm`,px+6,py+height/2)}var LINE2,CROSS,BEVEL,HANDLE,
GAP,LOWEST,tallest,SHORTEST,LEAST_FORCE,LEAST_LOAD,perLoad,greatestForce,distance,paintPath,init_needle2=__esm(
{"needlefit/viewer/page/painters/needle.js"(){init_handles();init_quantities();init_store();init_view();init_strokes();
LINE2=2.5,CROSS={of:.28,least:1,most:3.2},BEVEL={length:7.5,half:1.5},HANDLE=7,GAP=3,LOWEST=16,tallest=()=>Math.
min(48,.2*view.box.height-10),SHORTEST=5,LEAST_FORCE=.5,LEAST_LOAD=1e-6,perLoad=null,greatestForce={scene:null,
newton:0},distance=(one,other)=>Math.hypot(one[0]-other[0],one[1]-other[1]);paintPath=(context3,{tip_path:[x,y]})=>line(
context3,x,y,palette.path,1.5)}});function paintMeasured(context3,{x,y}){context3.lineCap="round",line(context3,x,y,palette.halo,4),line(context3,
x,y,palette.measured,2,[7,4]),context3.lineCap="butt",nameLine(context3,"measured",{x,y},palette.measured)}function nameLine(context3,name,{
x,y},colour2){labelBeside(context3,name,[[[x,y],16],[[x,y],-16]],colour2)}function nameNeedle(context3,state){
predictionOf(state,now.scene)||nameLine(context3,isSteered(state,now.scene)?"steered":"simulated",state,state.
faults.length?palette.bad:palette.needle)}function paintPinned(context3,{x,y}){line(context3,x,y,palette.halo,
5),line(context3,x,y,palette.ghost,2.5,[2,3]),labelBeside(context3,"pinned",[[[x,y],-18],[[x,y],18]],palette.ghost)}
function nameBand(context3,{x,low,high}){isChanged(now.state,now.scene)&&labelBeside(context3,"band of the fit",
[[[x,high],-14],[[x,low],14]],palette.band)}function paintBand(context3,{x,low,high},pale){faintly(context3,pale?
.16:.4,()=>fillBetween(context3,x,low,high,palette.band)),faintly(context3,pale?.4:1,()=>{for(let edge of[low,
high])line(context3,x,edge,palette.band,1.5)})}function paintPrediction(context3,state){let prediction=predictionOf(
state,now.scene);prediction&&(line(context3,prediction.x,prediction.y,palette.halo,4.5),line(context3,prediction.
x,prediction.y,palette.accent,2.5),labelBeside(context3,"prediction",[[[prediction.x,prediction.y],-16],[[prediction.
x,prediction.y],16]],palette.accent))}function paintGaps(context3,state,measured2){let{errors}=state;if(!errors)
return;let prediction=predictionOf(state,now.scene),needle=prediction??state,tip={x:needle.x.at(-1),y:needle.y.
at(-1)},reach=Math.min(tip.x,measured2.x.at(-1)),gaps=Array.from({length:GAPS-1},(_,n)=>reach*(n+1)/GAPS).map(
x2=>[needle,measured2].map(curve=>[toPx(x2),toPy(heightAt(curve,x2))]));segments(context3,gaps,palette.gap,1.25);
let[x,y]=errors.whole?[measured2.x.at(-1),measured2.y.at(-1)]:[reach,heightAt(measured2,reach)],end=errors.whole?
[tip.x,tip.y]:[reach,heightAt(needle,reach)];for(let[shown3,width]of[[palette.halo,5],[palette.gap,2.5]])line(
context3,[x,end[0]],[y,end[1]],shown3,width);setFont(context3,"strong");let[px,[,[key,named]]]=[toPx(x),measured2.
metrics],[top,bottom]=[toPy(y),toPy(end[1])].sort((one,other)=>one-other),sides=[[px,top-AWAY],[px,bottom+AWAY]];
state.bevel.side>0&&sides.reverse(),labelFree(context3,`tip error (${named}) ${(prediction?.errors??errors)[key].
toFixed(2)} mm`,[...sides,[px+60,top-AWAY],[px+60,bottom+AWAY],[px-90,top-AWAY],[px-90,bottom+AWAY]],palette.gap)}
function paintPlan(context3,{target:[x,y],radius,obstacles,needles:needles2}){faintly(context3,FAN,()=>{for(let[
xs,ys]of needles2)line(context3,xs,ys,palette.plan,1)});for(let[at,across,size3,name]of obstacles)paintCircle(
context3,at,across,size3,palette.tip,name,.28);paintCircle(context3,x,y,radius,palette.guide,"target"),segments(
context3,cross(toPx(x),toPy(y),CROSS2),palette.guide,2)}function paintCircle(context3,x,y,radius,shown3,name,opacity=0){
let[px,py,across]=[toPx(x),toPy(y),radius*view.scale];if(context3.beginPath(),context3.ellipse(px,py,across,across*
view.magnified,0,0,2*Math.PI),context3.fillStyle=shown3,faintly(context3,opacity,()=>context3.fill()),stroke(context3,
palette.halo,4),stroke(context3,shown3,2),px<view.box.left||px>view.box.left+view.box.width)return;setFont(context3,
"strong");let sides=[[px,toPy(y+radius)-12],[px,toPy(y-radius)+12]];now.state.bevel.side>0&&sides.reverse(),labelFree(
context3,name,sides,shown3)}function paintInset(context3,{x,y,tip}){if(tip.x<=0)return;let{left,top,width,height}=view.
box,places=[{x,y},now.scene.measured,now.band&&{x:now.band.x,y:now.band.low},now.band&&{x:now.band.x,y:now.band.
high}].flatMap(one=>one?placesOf(one.x,one.y):[]),wide=Math.min(INSET.width,.36*width),empty=([px2,py2])=>isFree(
[px2,py2,wide,INSET.height])&&places.every(([cx,cy])=>cx<px2-CLEAR||cx>px2+wide+CLEAR||cy<py2-CLEAR||cy>py2+INSET.
height+CLEAR),rows=[top+height-INSET.height-INSET.edge,top+INSET.edge],columns2=[left+INSET.edge,left+width-wide-
INSET.edge],corner=rows.flatMap(py2=>columns2.map(px2=>[px2,py2])).find(empty);if(!corner)return;let[px,py]=corner;
reserve(px,py,wide,INSET.height),context3.fillStyle=palette.air,context3.fillRect(px,py,wide,INSET.height),context3.
strokeStyle=palette.quiet,context3.lineWidth=1,context3.strokeRect(px+.5,py+.5,wide-1,INSET.height-1);let inserted=y.
filter((_,i)=>x[i]>=0),[low,high]=[Math.min(...inserted),Math.max(...inserted)],scale=Math.min((wide-2*INSET.edge)/
Math.max(now.scene.depth_mm,now.state.depth_mm,1),(INSET.height-INSET.title-6)/(high-low||1)),middle=py+(INSET.
height+INSET.title)/2;context3.beginPath(),x.forEach((one,i)=>one>=0&&context3.lineTo(px+INSET.edge+one*scale,
middle-(y[i]-(low+high)/2)*scale)),stroke(context3,palette.needle,Math.max(now.scene.diameter_mm*scale,1)),setFont(
context3,"small","left","top"),label(context3,"true scale",px+6,py+4)}var GAPS,FAN,CROSS2,AWAY,INSET,CLEAR,BAND_REACH,
isBandNear,init_overlay=__esm({"needlefit/viewer/page/painters/overlay.js"(){init_quantities();init_store();init_view();
init_strokes();GAPS=12,FAN=.3,CROSS2=5,AWAY=19,INSET={width:170,height:46,edge:10,title:14},CLEAR=30;BAND_REACH=
2,isBandNear=({x},state)=>x.length>0&&Math.abs(x.at(-1)-state.x.at(-1))<=BAND_REACH}});function invalidate(){stale=!0,publish("redraw")}function redraw(){frame||=requestAnimationFrame(()=>{frame=0,
paint(),fresh=!1,publish("drawn")})}function paint(){!now.scene||!now.state||(fresh&&follow(),paintScreen(),document.
body.classList.add("begun"))}function paintScreen(){let moved2=takeChange(),tissue=JSON.stringify(now.state.layers);
(moved2||tissue!==drawnTissue)&&paintBackground(behind,size()),drawnTissue=tissue,(moved2||fresh||stale)&&(before.
clearRect(0,0,...size()),paintForeground(before,now.state)),stale=!1}function paintAll(context3,figure){paintBackground(
context3,figure),paintForeground(context3,now.state)}function paintBackground(context3,figure){context3.fillStyle=
palette.gutter,context3.fillRect(0,0,...figure),within(context3,()=>paintTissue(context3)),paintAxes(context3)}
function paintForeground(context3,state){let band2=shown.band&&now.band&&isBandNear(now.band,state)?now.band:null;
clearBoxes(),reserveNeedle(state),context3.lineJoin="round",within(context3,()=>{let loaded=shown.load&&!state.
faults.length;loaded&&paintLoad(context3,state),band2&&paintBand(context3,band2,band2.step!==state.step),shown.
plan&&now.scene.plan&&paintPlan(context3,now.scene.plan),shown.pinned&&now.pinned&&paintPinned(context3,now.pinned),
paintNeedle(context3,state),paintInset(context3,state),paintTip(context3,state),loaded&&paintTipForce(context3,
state),shown.path&&paintPath(context3,state),shown.points&&paintPoints(context3,state),paintPrediction(context3,
state),shown.measured&&now.scene.measured&&(paintMeasured(context3,now.scene.measured),shown.errors&&paintGaps(
context3,state,now.scene.measured));for(let draw4 of further)draw4(context3);paintGuides(context3,state),paintBase(
context3,state),(shown.measured&&now.scene.measured||shown.pinned&&now.pinned)&&nameNeedle(context3,state),band2&&
nameBand(context3,band2),now.marked!=null&&paintMark(context3,state,now.marked)}),shown.load&&!state.faults.length&&
paintKey(context3)}function within(context3,draw4){let{left,top,width,height}=view.box;context3.save(),context3.
beginPath(),context3.rect(left,top,width,height),context3.clip(),draw4(),context3.restore()}function measure(){
let[width,height]=measured=[picture.clientWidth,picture.clientHeight];for(let[canvas4,context3]of[[background,
behind],[foreground,before]])canvas4.width=Math.round(width*devicePixelRatio),canvas4.height=Math.round(height*
devicePixelRatio),context3.setTransform(devicePixelRatio,0,0,devicePixelRatio,0,0);resize(width,height)}var picture,
background,foreground,behind,before,shown,further,drawnTissue,stale,frame,fresh,measured,size,fitted,init_drawing=__esm(
{"needlefit/viewer/page/drawing.js"(){init_dom();init_background();init_needle2();init_overlay();init_strokes();
init_store();init_view();picture=part("picture"),background=part("background"),foreground=part("canvas"),behind=
background.getContext("2d",{alpha:!1}),before=foreground.getContext("2d"),shown={load:!0,points:!0,path:!0,measured:!0,
band:!0,errors:!0,plan:!0,pinned:!0,strip:!0},further=[],drawnTissue="",stale=!0;[frame,fresh]=[0,!1];measured=
[1,1],size=()=>measured;new ResizeObserver(measure).observe(picture);onScheme(()=>(readPalette(),touch()));readPalette();
for(let kind of["band","forces"])listen(kind,invalidate);fitted=null;listen("state",()=>{fresh=!0,redraw(),fitted!==
now.scene&&(fitted=now.scene,fit(view.fit??"tissue"))});listen("redraw",redraw)}});function turn(state){let across=([x,,z=x.map(()=>0)])=>[x,z],roll2=state.bevel.roll_deg*Math.PI/180;return{...state,
y:state.z,constraints:across(state.constraints),tip_path:across(state.tip_path),bevel:{side:Math.sin(roll2)<0?
-1:1}}}function draw(){if(canvas.hidden=!now.state||!isSpatial(),canvas.hidden)return;let{clientWidth:width,clientHeight:height}=canvas,
size3=[width,height].map(one=>Math.round(one*devicePixelRatio));(canvas.width!==size3[0]||canvas.height!==size3[1])&&
([canvas.width,canvas.height]=size3),context.setTransform(devicePixelRatio,0,0,devicePixelRatio,0,0),context.fillStyle=
palette.gutter,context.fillRect(0,0,width,height);let{band:band2,scene:{measured:measured2}}=now,state={...now.
state,z:now.state.z??now.state.x.map(()=>0)},seen=[...state.z,...measured2?.z??[],...band2?.z?.low??[],...band2?.
z?.high??[],0],[low,high]=[Math.min(...seen),Math.max(...seen)],{y,box:box2,magnified}=view,within2={...box2,top:EDGE2,
height:height-2*EDGE2},times=Math.min(magnified,(within2.height-2*ROOM2)/(view.scale*(high-low||1)));Object.assign(
view,{y:(low+high)/2,box:within2,magnified:times}),context.save(),context.beginPath(),context.rect(box2.left,EDGE2,
box2.width,within2.height),context.clip(),paintTissue(context);let needle=turn(state);shown.band&&band2?.z&&isBandNear(
band2,state)&&paintBand(context,{x:band2.x,...band2.z},band2.step!==state.step),context.lineJoin="round",paintNeedle(
context,needle),shown.path&&paintPath(context,needle),shown.points&&paintPoints(context,needle),measured2&&shown.
measured&&paintMeasured(context,{...measured2,y:measured2.z}),setFont(context,"small","left"),label(context,"f\
rom above",box2.left+6,EDGE2+10),context.restore(),paintFrame(context,times===1?"z (mm)":`z (mm), drawn ${brief(
times,2)}×`),Object.assign(view,{y,box:box2,magnified})}var EDGE2,ROOM2,canvas,context,isSpatial,init_above=__esm(
{"needlefit/viewer/page/above.js"(){init_dom();init_drawing();init_background();init_needle2();init_overlay();
init_strokes();init_quantities();init_store();init_view();[EDGE2,ROOM2]=[8,14],canvas=part("above"),context=canvas.
getContext("2d",{alpha:!1}),isSpatial=()=>!!(now.state?.z??now.scene?.measured?.compared==="space");for(let kind of[
"drawn","scene"])listen(kind,draw);new ResizeObserver(draw).observe(canvas);onScheme(()=>requestAnimationFrame(
draw))}});function computeErrors(session,measured2){let{depth}=session.shape,upto=Math.min(depth,measured2.depth_mm);if(upto<
1)return null;let beyond=depth-measured2.depth_mm,whole=Math.abs(beyond)<=1e-6,[simulated,other]=[null,null];if(whole){
let{s,x,y,z,pose}=measured2.target;other=x.map((one,i)=>[one,y[i],z[i]]),simulated=readPoints(session,s.map(one=>one+
beyond)),simulated=ALIGN[pose](simulated,other)}else if(measured2.target.pose!=="free"){let s=Array.from({length:101},
(_,i)=>upto*i/100);other=interpolate(measured2,s),simulated=ALIGN[measured2.target.pose](readPoints(session,s),
other)}else return null;let axes=AXES[measured2.compared],distances=simulated.map((point,i)=>Math.hypot(...axes.
map(axis=>point[axis]-other[i][axis]))),deflection=Math.hypot(...axes.slice(1).map(axis=>other.at(-1)[axis]-other[0][axis])),
finite=Object.entries(METRICS).map(([name,compute])=>[name,compute(distances,deflection)]).map(([name,value])=>[
name,Number.isFinite(value)?value:null]);return{...Object.fromEntries(finite),upto_mm:upto,whole,floor_mm:measured2.
floor_mm}}function readPoints(session,s){let{x,depth,planes}=session.shape,points=session.positions(s.map(one=>Math.
min(Math.max(one,x[0]),depth)));return s.map((_,i)=>[points[(1+planes)*i],points[(1+planes)*i+1],planes===1?0:
points[3*i+2]])}function interpolate({s,...axes},at){let i=0;return at.map(one=>{for(;i<s.length-2&&s[i+1]<one;)
i+=1;let share=Math.min(Math.max((one-s[i])/(s[i+1]-s[i]),0),1);return["x","y","z"].map(axis=>axes[axis][i]+share*
(axes[axis][i+1]-axes[axis][i]))})}function shiftAcross(moving,fixed){let[dy,dz]=[1,2].map(axis=>mean(moving.map(
(point,i)=>fixed[i][axis]-point[axis])));return moving.map(([x,y,z])=>[x,y+dy,z+dz])}function alignRigid(moving,fixed){
let centre=points=>[0,1].map(axis=>mean(points.map(one=>one[axis]))),[m,f]=[centre(moving),centre(fixed)],[across,
along]=[0,0];moving.forEach(([x,y],i)=>{let[a,b,c2,d]=[x-m[0],y-m[1],fixed[i][0]-f[0],fixed[i][1]-f[1]];across+=
a*d-b*c2,along+=a*c2+b*d});let angle2=Math.atan2(across,along),[c,s]=[Math.cos(angle2),Math.sin(angle2)];return moving.
map(([x,y,z])=>[c*(x-m[0])-s*(y-m[1])+f[0],s*(x-m[0])+c*(y-m[1])+f[1],z])}var mean,relate,METRICS,AXES,ALIGN,init_errors=__esm(
{"needlefit/viewer/page/model/errors.js"(){mean=values=>values.reduce((sum,one)=>sum+one,0)/values.length,relate=
(d,deflection)=>deflection?100*d.at(-1)/deflection:d.at(-1)?1/0:0,METRICS={median_err_mm:d=>{let sorted=d.toSorted(
(one,other)=>one-other),half=sorted.length>>1;return sorted.length%2?sorted[half]:(sorted[half-1]+sorted[half])/
2},ipe_mean_mm:mean,ipe_std_mm:d=>{let middle=mean(d);return Math.sqrt(mean(d.map(one=>(one-middle)**2)))},ipe_max_mm:d=>Math.
max(...d),te_mm:d=>d.at(-1),edp_percent:relate},AXES={plane:[0,1],space:[0,1,2]};ALIGN={known:simulated=>simulated,
direction:shiftAcross,free:alignRigid}}});function computeValidity({x,u,slope:slope2,planes,constraints,track},{boundaries,thickness,spacing}){let last2=x.
length-1,bent=Array.from({length:planes},(_,p)=>[u,slope2].map(one=>one.subarray(p*x.length,(p+1)*x.length))),
cubics=bent.map(()=>[0,0,0]),[rotations,missed]=[bent.map(()=>0),bent.map(()=>0)],rotate=t=>(cubics.forEach(([
begin2,bend,curl],p)=>rotations[p]=begin2+t*(bend+t*curl)),measure2(rotations)),steepest=0,shortening=0,miss=0;
for(let i=0;i<=last2;i+=1)steepest=Math.max(steepest,measure2(bent.map(([,one])=>one[i])));for(let i=0;i<last2;i+=
1){let step=x[i+1]-x[i];bent.forEach(([v,rotation],p)=>{let mean2=(v[i+1]-v[i])/step,begin2=rotation[i],end=rotation[i+
1];cubics[p]=[begin2,6*mean2-4*begin2-2*end,3*(begin2+end)-6*mean2]});let[[,bend,curl]]=cubics,inside=planes>1?
[.25,.5,.75]:[Math.abs(curl)>1e-12?-.5*bend/curl:0];for(let at of inside)at>0&&at<1&&(steepest=Math.max(steepest,
rotate(at)));for(let[t,weight]of GAUSS){let angle2=rotate(t);shortening+=step*weight*2*Math.sin(angle2/2)**2,x[i]<
-1e-9&&angle2&&rotations.forEach((one,p)=>missed[p]+=step*weight*one*(1-Math.sin(angle2)/angle2))}miss=Math.max(
miss,measure2(missed))}for(let i=0;i<track.length;i+=2*planes)steepest=Math.max(steepest,measure2(bent.map((_,p)=>track[i+
2*p+1])));let entered=1+boundaries.filter(end=>end<x[last2]).length,widths=boundaries.slice(0,entered).map((end,i)=>end-
(i?boundaries[i-1]:0)).filter(width=>width>0),thinnest=widths.length?Math.max(Math.min(...widths),spacing):1/0;
return{max_slope:steepest,deflection_per_length:measure2(bent.map(([v])=>Math.max(...v)-Math.min(...v)))/(x[last2]-
x[0]),shortening_per_layer:shortening/thinnest,miss_mm:miss,compression:compress(x,bent,constraints)/Math.min(
...thickness.slice(0,entered))}}function compress(x,bent,constraints){let[greatest2,i]=[0,0];for(let k=0;k<constraints.
length;k+=1+bent.length){let at=constraints[k];for(;i<x.length-2&&x[i+1]<at-1e-9;)i+=1;let span=x[i+1]-x[i],t=Math.
min(Math.max((at-x[i])/span,0),1),away=bent.map(([u,slope2],p)=>{let bend=3*(u[i+1]-u[i])-span*(2*slope2[i]+slope2[i+
1]),curl=2*(u[i]-u[i+1])+span*(slope2[i]+slope2[i+1]);return u[i]+t*(span*slope2[i]+t*(bend+t*curl))-constraints[k+
1+p]});greatest2=Math.max(greatest2,measure2(away))}return greatest2}var GAUSS,measure2,listFaults,init_validity=__esm(
{"needlefit/viewer/page/model/validity.js"(){GAUSS=[[.5-Math.sqrt(.15),.2777777777777778],[.5,.4444444444444444],
[.5+Math.sqrt(.15),.2777777777777778]],measure2=parts=>parts.length>1?Math.sqrt(parts[0]**2+parts[1]**2):Math.
abs(parts[0]);listFaults=(validity,limits)=>limits.filter(([name,limit])=>!(validity[name]<=limit)).map(([name,
limit,words])=>{let unit=name.endsWith("_mm")?" mm":"";return`${words} ${Number(validity[name].toPrecision(3))}${unit}\
 (limit ${limit}${unit})`})}});function makeLaw({terms,tables},shape){if(!terms)return tables.find(([known])=>JSON.stringify(known)===JSON.stringify(
shape))?.[1]??null;let layers=shape[0]?.length??terms.layers;return Array.from({length:layers},(_,layer)=>terms.
at_zero.map((value,j)=>{let by=terms.slopes.findIndex(row=>row[j]);return by<0?value:value+shape[by][layer]*terms.
slopes[by][j]})).flat()}var SteeredNeedle,init_steered=__esm({"needlefit/viewer/page/model/steered.js"(){init_needle();
init_inputs();init_validity();SteeredNeedle=class _SteeredNeedle{static async begin(kernel,scene){let{model,steps:steps2}=scene.
simulation;return new _SteeredNeedle(scene,await Session.begin(kernel,model,toInputs(steps2[0],model.pathAngle)))}scene;session;rules;shape;names;number;saved;valid;validity;way=null;constructor(scene,session){
let{shape,steps:steps2,rules}=scene.simulation;Object.assign(this,{scene,session,rules,shape,names:scene.guide_names}),
Object.assign(this,{number:0,saved:new Map,valid:!0}),this.step={...steps2[0],depth:0},this.#judge(),this.keep()}get model(){
return this.session.model}reach(controls=this.step.controls){let[first]=controls.guides;return this.model.length+
(first?.x<0?first.x-this.rules.clearance_mm:0)-1e-6}get tipLateral(){return this.session.positions([this.session.
shape.depth])[1]}path(){return this.session.path().map(one=>toStep(one,this.model.pathAngle))}listWay(){let found=[];
for(let one=this.way;one;one=one.before)found.push(one);return found.reverse()}keep(){let{step,shape,valid,validity,
way}=this;this.saved.has(this.number)||this.saved.set(this.number,{step,shape,valid,validity,way,session:this.
session.save()})}forget(number){number&&this.saved.delete(number)}rewind(){let[[,first]]=this.saved;this.#return(
first),Object.assign(this,{number:0,saved:new Map([[0,first]])})}#return({session,...saved}){this.session.restore(
session),Object.assign(this,saved)}shapeAfter(changes){let shape=this.shape.map(row=>[...row]);for(let[name,item,
value]of changes){let row=this.scene.shape_parameters.findIndex(one=>one.name===name);row>=0&&(shape[row][item-
1]=value)}return shape}apply(changes,{validOnly=!0}={}){for(let[i,change2]of changes.entries()){checkChange(change2,
this.rules);let[name,item]=change2;if(changes.slice(0,i).some(([one,other])=>one===name&&other===item))throw new ModelError(
`${name} has two values in one step`,"one value for each input");if(name==="return_to"&&changes.length>1)throw new ModelError(
"return_to stands beside other inputs","a step of its own")}if(changes[0]?.[0]==="return_to"){let saved=this.saved.
get(changes[0][2]);if(!saved)throw new ModelError(`nothing was kept of step ${changes[0][2]}`,"a step to retur\
n to");this.#return(saved)}else this.#advance(changes,validOnly),this.way={changes,tip:this.tipLateral,before:this.
way};this.number+=1}#advance(changes,validOnly){let parameters=changes.filter(([name])=>this.rules.inputs[name].
parameter),others=changes.filter(([name])=>!this.rules.inputs[name].parameter);if(!parameters.length)return this.#move(
others,validOnly);let{step,shape,valid,validity}=this,before2={step,shape,valid,validity,session:this.session.
save()};try{this.#simulateAgain(parameters,validOnly),this.#move(others,validOnly)}catch(error){throw this.#return(
before2),error}}#simulateAgain(parameters,validOnly){let mu=[...this.model.mu],[offset,angle2]=[null,null];for(let[
name,item,value]of parameters){if(item>mu.length)throw new ModelError(`there is no layer ${item}`,`one of ${mu.
length} layers`);if(name==="mu_pa")mu[item-1]=value*1e-6;else if(name==="offset_throughout_mm")offset=value;else if(name===
"cut_angle_throughout_deg")angle2=value*(Math.PI/180);else if(!this.scene.shape_parameters.some(one=>one.name===
name))throw new ModelError(`the tissue law has no ${name}`,"a parameter of the law")}let shape=this.shapeAfter(
parameters),law=JSON.stringify(shape)===JSON.stringify(this.shape)?this.model.law:makeLaw(this.scene.simulation.
law,shape);if(!law)throw new ModelError("the law has not been computed with these parameters","the program","t\
ry again");let{pathAngle}=this.model,steps2=this.path().map(({bevel,...one})=>({...one,bevel:{...bevel,offset:offset??
bevel.offset,cutAngle:angle2??bevel.cutAngle}}));if(!this.#guard(()=>this.session.again({...this.model,mu,law},
steps2.map(one=>({depth:one.depth,inputs:toInputs(one,pathAngle)})))))throw new ModelError(`with these paramet\
ers the insertion so far fails ${this.session.depth.toFixed(1)} mm deep`,"a load that tissue and needle can be\
ar","change them less, or retract the needle first");let was=this.valid;Object.assign(this,{shape,step:steps2.
at(-1)}),this.#judge(),validOnly&&was&&!this.valid&&this.#refuseInvalid(this.validity)}#move(changes,validOnly){
let{session}=this,{x,u,planes}=session.shape,step=applyChanges(this.step,changes,this.names,[u[x.length-1],planes>
1?u.at(-1):0]);if(!changes.length)return;let[first]=step.controls.guides;if(validOnly&&first?.x<0&&step.depth>
this.reach(step.controls)+1e-6)throw new ModelError(`the base would stand ${(first.x+this.model.length-step.depth).
toFixed(2)} mm before the first guide`,`at least ${this.rules.clearance_mm} mm: the base stops at the guide`,"\
retract the needle, or move the guide toward the tissue");let[refused,judged]=[!1,{}],judge=shape2=>{let validity=computeValidity(
shape2,this.model);return judged={validity,valid:listFaults(validity,this.rules.validity).length===0},refused=
validOnly&&this.valid&&!judged.valid,!refused},shape=this.#guard(()=>session.go(step.depth,toInputs(step,this.
model.pathAngle),judge));if(refused&&this.#refuseInvalid(judged.validity),session.failed)throw new ModelError(
`the model finds no needle there (${shape.status})`,"a load that tissue and needle can bear","move less at a t\
ime");Object.assign(this,{step,...judged}),judged.validity||this.#judge()}#guard(work2){try{return work2()}catch(error){
throw error instanceof RangeError?new ModelError(error.message,`a needle of ${this.model.length} mm, its base \
before guides and tissue`,"lessen the depth, or move the guides"):error}}#judge(){this.validity=computeValidity(
this.session.shape,this.model),this.valid=listFaults(this.validity,this.rules.validity).length===0}#refuseInvalid(validity){
throw new ModelError(`the needle would be outside the model's validity: ${listFaults(validity,this.rules.validity).
join("; ")}`,"a needle within the limits of small deflections","move less, or bring base, guides and tip neare\
r to the needle's own shape")}}}});function listKeys({fitted:fitted2,shape_parameters:shapes}){let{key,throughout}=strengthOf(fitted2),plain=value=>value,
strength=key==="offset_mm"?{key:"b",toModel:plain,read:({step})=>step.bevel.offset}:{key:"theta",toModel:value=>value*
(Math.PI/180),read:({step})=>step.bevel.cutAngle},layers=fitted2.layers.flatMap((_,i)=>[{key:`mu${i+1}`,input:"\
mu_pa",item:i+1,toInput:value=>value*1e3,toModel:value=>value*1e3*1e-6,read:({model})=>model.mu[i]},...shapes.
map(({name},row)=>({key:`${name}${i+1}`,input:name,item:i+1,toInput:plain,toModel:plain,read:({shape})=>shape[row][i]}))]);
return[{...strength,input:throughout,item:null,toInput:plain},...layers]}function findText(toModel,value,guess){
let near2=ULPS.map(ulps=>guess+ulps*Math.abs(guess)*11102230246251565e-32),found=[...Array.from({length:15},(_,n)=>Number(
guess.toPrecision(n+1))),...near2].find(one=>toModel(one)===value);return found===void 0?null:String(found)}function listLost({
scene:{simulation:{steps:[first]}},step},path){let all2=[...path,step],differs=read=>all2.some(one=>!same2(read(
one.controls),read(first.controls)));return[[differs(({baseY})=>baseY),"the base, which was moved"],[differs(({
baseSlope})=>baseSlope),"the base, which was turned"],[differs(({guides:guides2})=>guides2.map(({x,y,slope:slope2})=>[
x,y,slope2])),"the guides"],[differs(({tip})=>tip&&[tip.y,tip.slope]),"the tip, which was held"],[all2.some(({
bevel})=>bevel.offset!==step.bevel.offset||bevel.cutAngle!==step.bevel.cutAngle),"b, which changed on the way"]].
filter(([is])=>is).map(([,words])=>words)}async function writeAddress(kernel,steered,name=null){let{scene,step}=steered,
path=steered.path(),lost=listLost(steered,path);if(lost.length)return{lost};let rolls=path.map(({bevel})=>wrap(
rollOf(bevel))),values=new URLSearchParams(name===null?{}:{needle:name});values.set("depth",step.depth),values.
set("roll",rolls.at(-1));let turns=path.slice(0,-1).map(({depth},i)=>{let by=findText(one=>wrap(rolls[i+1]-one),
rolls[i],wrap(rolls[i+1]-rolls[i]));return by==="180"?depth:`${depth}:${by}`});turns.length&&values.set("turn",
turns.join(","));let{model,shape,steps:[first]}=scene.simulation;for(let{key,item,toModel,read}of listKeys(scene)){
let value=read(steered);if(item&&value===read({model,shape,step:first}))continue;let text=findText(toModel,value,
value/toModel(1));if(text===null)return{lost:[key]};values.set(key,text)}let address=values.toString().replaceAll(
"%2C",",").replaceAll("%3A",":");return await leadsTo(kernel,address,steered)?{address}:{lost:["the path"]}}async function leadsTo(kernel,address,steered){
let other=await SteeredNeedle.begin(kernel,steered.scene);try{for(let changes of readAddress(address,steered.scene))
other.apply(changes,{validOnly:!1})}catch(error){if(!error.what)throw error;return!1}let{depth}=steered.step,points=({
session})=>readPoints(session,Array.from({length:POINTS2},(_,i)=>depth*i/(POINTS2-1))),[found,wanted]=[other,steered].
map(points);return found.every((point,i)=>Math.hypot(...point.map((one,axis)=>one-wanted[i][axis]))<SAME3)}function settle(steered){
let[now2]=steered.model.mu,mu=ULPS.map(ulps=>now2*1e6+ulps*now2*1e6*2**-53).find(one=>one*1e-6===now2);mu&&steered.
apply([["mu_pa",1,mu]],{validOnly:!1})}function readAddress(address,scene){let values=new URLSearchParams(address),
keys=listKeys(scene),known=["needle","depth","roll","turn",...keys.map(({key})=>key)],number=(key,text,low=-1/0)=>{
let value=Number(text);if(text.trim()!==""&&Number.isFinite(value)&&value>=low)return value;throw new ModelError(
`the address has ${key}=${text}`,low<0?"a number":`a number, ${low} or above`)};for(let key of values.keys())if(!known.
includes(key))throw new ModelError(`the address has ${key}`,known.join(", "));let doubled=[...values.keys()].find(
key=>values.getAll(key).length>1);if(doubled)throw new ModelError(`the address has ${doubled} more than once`,
"each key once");if(!values.has("depth")){if([...values.keys()].some(key=>key!=="needle"))throw new ModelError(
"the address has no depth","depth=, in mm");return[]}let[first]=scene.simulation.steps,depth=number("depth",values.
get("depth"),0),turns=(values.get("turn")??"").split(",").filter(Boolean).map(text=>{let[at,by="180"]=text.split(
":");return{at:number("turn",at,0),by:number("turn",by)}});if(!turns.every(({at},i)=>at>0&&at>=(turns[i-1]?.at??
0)&&at<=depth))throw new ModelError(`the address has turn=${values.get("turn")}`,`increasing depths, up to ${depth}\
 mm`);let roll2=values.has("roll")?number("roll",values.get("roll")):rollOf(first.bevel),after=turns.toReversed().
map(({by})=>{let end=roll2;return roll2=wrap(roll2-by),end}).reverse(),inputs=keys.filter(({key})=>values.has(
key)).map(({key,input,item,toInput})=>[input,item,toInput(number(key,values.get(key)))]),lists=[ANEW,[["bevel_\
roll_deg",null,roll2],...inputs]];return turns.forEach(({at},i)=>lists.push([["depth_mm",null,at]],[["bevel_ro\
ll_deg",null,after[i]]])),[...lists,[["depth_mm",null,depth]]]}function writeRecording(head,steered){let rows=steered.
listWay().flatMap(({changes,tip},i)=>changes.map(([name,item,value],n)=>`${i+1},${(i/10).toFixed(4)},${name},${item??
""},${value},${n===changes.length-1?tip:""}`));return`${head}${rows.join(`
`)}
`}var ANEW,POINTS2,SAME3,ULPS,same2,nameIn,init_address=__esm({"needlefit/viewer/page/address.js"(){init_errors();
init_inputs();init_steered();init_quantities();ANEW=[["return_to",null,0]],POINTS2=21,SAME3=1e-6,ULPS=[0,1,-1,
2,-2,3,-3,4,-4],same2=(one,other)=>JSON.stringify(one)===JSON.stringify(other);nameIn=address=>new URLSearchParams(
address).get("needle")}});function computeBands(worker,kernel,current2){let ordered="";worker.postMessage({kernel});function describeNeedle(){
let{name,steered}=current2(),{model}=steered,steps2=steered.path().map(one=>({depth:one.depth,inputs:toInputs(
one,model.pathAngle)}));return{id:{needle:name,step:now.state.step},model,steps:steps2,planes:steered.session.
planes}}function order(){if(!now.state)return;let about=JSON.stringify([current2().name,now.state.step]);ordered!==
about&&(ordered=about,worker.postMessage(describeNeedle()))}function send(){ordered="",worker.postMessage({draws:now.
scene.draws,steps:null}),order()}worker.onmessage=({data:{id,band:band2,forces}})=>{id.needle===current2().name&&
(forces?take({kind:"forces",step:id.step,...forces}):take(band2?{kind:"band",step:id.step,...band2}:NONE))},listen(
"scene",send),listen("drawn",order)}var NONE,init_bands=__esm({"needlefit/viewer/page/bands.js"(){init_inputs();
init_store();NONE={kind:"band",x:[]}}});function describeState(steered){let{scene,session,step,model,names,validity,rules}=steered,{shape}=session,{controls,
bevel}=step,width=1+shape.planes,[x,y,z=null]=columns(session.positions(listStations(shape)),width),constraints=columns(
shape.constraints,width),track=columns(shape.track,2*shape.planes).filter((_,i)=>i%2===0),load3=session.forces(),
loaded=columns(load3.s.length?session.positions(load3.s):[],width),last2=shape.x.length-1,roll2=wrap(rollOf(bevel)),
items=controls.guides.map(({name})=>guideNumber(name,names));return{kind:"state",step:steered.number,depth_mm:step.
depth,x,y,z,depths:constraints[0],constraints:mapPoints(session,constraints),tip_path:mapPoints(session,[constraints[0],
...track]),load:{x:loaded[0],y:loaded[1],n_per_mm:load3.loads.map(one=>[...one])},forces:{base_n:load3.base.force,
base_nmm:load3.base.moment,guides_n:Object.fromEntries(items.map((item,i)=>[item,load3.guides[i].force]))},base:{
x:x[0],y:y[0],rotation:shape.slope[0],input_y:controls.baseY,input_slope:controls.baseSlope},guides:controls.guides.
map(({name,x:x2,y:y2,slope:slope2},i)=>({item:items[i],name,x:x2,y:y2,slope:slope2??0,turns_freely:slope2===null})),
tip:{x:x.at(-1),y:y.at(-1),z:z&&z.at(-1),rotation:shape.slope[last2],lateral_mm:y.at(-1),held:controls.tip!==null,
input_y:shape.u[last2]},bevel:{side:Math.abs(roll2)>90?-1:1,roll_deg:roll2,...describeStrength(bevel,model)},layers:model.
mu.map((mu,layer)=>({mu_pa:mu*1e6,...Object.fromEntries(scene.shape_parameters.map(({name},row)=>[name,steered.
shape[row][layer]]))})),max_slope:validity.max_slope,faults:listFaults(validity,rules.validity),errors:scene.measured&&
computeErrors(session,scene.measured)}}function listStations({x,depth}){let end=Math.min(0,depth),before2=Array.
from({length:POINTS_BEFORE_TISSUE},(_,i)=>x[0]+(end-x[0])*i/(POINTS_BEFORE_TISSUE-1));return before2[POINTS_BEFORE_TISSUE-
1]=end,Float64Array.from(new Set([...before2,...x])).sort()}function mapPoints(session,[s,...beside]){let[along,
...places]=columns(session.positions(s),1+beside.length),deflections=session.deflections(s);return[along,...places.
map((one,plane)=>one.map((place2,i)=>place2+(beside[plane][i]-deflections[plane*s.length+i])))]}var POINTS_BEFORE_TISSUE,
columns,describeStrength,init_state=__esm({"needlefit/viewer/page/model/state.js"(){init_inputs();init_errors();
init_validity();POINTS_BEFORE_TISSUE=25,columns=(points,width)=>Array.from({length:width},(_,axis)=>Array.from(
{length:points.length/width},(_2,i)=>points[width*i+axis])),describeStrength=({offset,cutAngle},{pathAngle})=>pathAngle?
{cut_angle_deg:cutAngle*(180/Math.PI)}:{offset_mm:offset}}});async function unpack(id){let bytes=Uint8Array.from(atob(part(id).textContent),one=>one.charCodeAt(0)),stream=new Blob(
[bytes]).stream().pipeThrough(new DecompressionStream("deflate-raw"));return new Response(stream).arrayBuffer()}
async function load(){let[data,kernel]=await Promise.all([unpack("data"),unpack("kernel").then(compile)]),{lists,
...read}=JSON.parse(new TextDecoder().decode(data)),resolve=value=>Array.isArray(value?.$)||Number.isInteger(value?.
$)?lists[value.$]:value;for(let{scene}of read.needles)if(scene.draws)for(let name of["mu","law","strength"])scene.
draws[name]=resolve(scene.draws[name]);return{...read,kernel}}function insert(steered){for(let changes of listSteps(
steered.scene))steered.apply(changes,always)}function compareStored(steered,{methods:[fit2]=[],tip},same3){if(!fit2)
return Math.abs(steered.tipLateral-tip);let{target,stored}=steered.scene.measured,fixed=target.x.map((x,i)=>[x,
target.y[i],target.z[i]]),points=ALIGN[target.pose](readPoints(steered.session,target.s),fixed),found=computeErrors(
steered.session,steered.scene.measured),errors=Object.keys(fit2.errors).map(name=>Math.abs(fit2.errors[name]-found[name]));
return Math.max(...points.flatMap((point,i)=>["x","y","z"].map((axis,n)=>Math.abs(point[n]-stored[axis][i]))),
...errors.filter(one=>one>same3))}async function prove({needles:needles2,kernel},same3){let[count,largest,since]=[
0,0,performance.now()],rest=async()=>{performance.now()-since<SLICE||(await new Promise(done2=>setTimeout(done2)),
since=performance.now())};for(let needle of needles2){let compare=distance2=>{count+=1,largest=Math.max(largest,
distance2)};try{let steered=await begin(kernel,needle);if(needle.recording){let replay=new Replay(steered,needle.
recording);for(let n=1;n<=needle.recording.length;n+=1)replay.to(n),compare(Math.abs(steered.tipLateral-needle.
recording[n-1][2])),await rest()}else{if(insert(steered),needle.tip===null)continue;compare(compareStored(steered,
needle,same3))}}catch(error){if(!error.what)throw error;compare(NaN)}await rest()}return{count,largest}}var SLICE,
begin,always,Replay,init_stored=__esm({"needlefit/viewer/page/stored.js"(){init_needle();init_dom();init_errors();
init_inputs();init_steered();SLICE=12;begin=(kernel,{scene})=>SteeredNeedle.begin(kernel,scene),always={validOnly:!1};
Replay=class{steered;steps;at;changed;last;constructor(steered,steps2){Object.assign(this,{steered,steps:steps2,
at:0,changed:!1,last:new Map}),this.steps.forEach(([,changes],i)=>{for(let[name,,value]of changes)name==="retu\
rn_to"&&this.last.set(value,i+1)})}to(n){for((this.changed||n<this.at)&&(this.steered.rewind(),Object.assign(this,
{at:0,changed:!1}));this.at<n;)this.#next()}#next(){let[,changes]=this.steps[this.at];this.steered.apply(changes,
always),this.at+=1,this.last.has(this.at)&&this.steered.keep();for(let[name,,value]of changes)name==="return_t\
o"&&this.last.get(value)===this.at&&this.steered.forget(value)}}}});function refuse(error,below=part("flip").parentElement){if(!error.what)throw error;below.after(refusal),write(
refusal,`${error.what}. Expected: ${error.expected}.`)}function show(){steps+=1,part("undo").disabled=!past.length,
part("redo").disabled=!future.length,take({...describeState(now.steered),step:steps,kind:"state"})}function forgetPast(){
for(let one of[past,future])one.length=0;last=0,write(refusal,"")}function goHome(){forgetPast(),now.steered.rewind();
try{insert(now.steered)}catch(error){refuse(error)}show()}function steer(lists,{gesture=newGesture(),whole=!1,
anew=!1,below=void 0}={}){let{steered}=now,{number}=steered;publish("steers"),write(refusal,"");let begins=gesture!==
last;(begins||whole)&&steered.keep();try{for(let changes of lists)steered.apply(changes.map(([name,item,value])=>[
name,item,value+0]),always2);anew&&settle(steered)}catch(error){if(refuse(error,below),whole&&steered.number>number&&
steered.apply([["return_to",null,number]]),whole||steered.number===number)return void publish("unchanged")}begins&&
(past.push(number),future.length=0,past.length>MOST_UNDONE&&steered.forget(past.shift())),last=gesture,part("b\
ack").disabled=!1,show()}function goTo(from,to){if(!from.length)return;publish("steers"),write(refusal,"");let{
steered}=now;steered.keep(),to.push(steered.number),steered.apply([["return_to",null,from.pop()]]),last=0,show()}
var MOST_UNDONE,always2,refusal,past,future,steps,gestures,last,newGesture,change,undo,redo,init_steering=__esm(
{"needlefit/viewer/page/steering.js"(){init_address();init_dom();init_state();init_stored();init_store();MOST_UNDONE=
200,always2={validOnly:!1},refusal=part("refusal"),[past,future]=[[],[]],[steps,gestures,last]=[0,0,0],newGesture=
()=>gestures+=1;change=(changes,how)=>steer([changes],how);undo=()=>goTo(past,future),redo=()=>goTo(future,past);
listen("notice",({what,expected})=>refuse({what,expected}))}});async function followAddress(choose2){let address=location.hash.slice(1);if(!address)return!1;let{needles:needles2}=now.
data,below=part("proof").parentElement;try{if(part(decode(address)))return!1;let name=nameIn(address),number=needles2.
findIndex(one=>nameOf2(one)===name);if(name!==null&&number<0)throw new ModelError(`the address has needle=${name}`,
needles2.map(nameOf2).join(", "));number>=0&&needles2[number]!==now.needle&&await choose2(number);let lists=readAddress(
address,now.scene);return lists.length&&steer(lists,{below,whole:!0,anew:!0}),lists.length>0}catch(error){return refuse(
error,below),!0}}function decode(address){try{return decodeURIComponent(address)}catch{throw new ModelError(`t\
he address ends with #${address}, which is no text`,"depth=, in mm, as Copy link writes it")}}async function copy(){
let{data:{needles:needles2,kernel},needle,scene,steered}=now,{address,lost}=await writeAddress(kernel,steered,
needles2.length>1?nameOf2(needle):null);write("link-note",lost?`No link: an address does not carry ${lost.join(
", ")}. A recording does.`:""),!lost&&(steer(readAddress(address,scene),{anew:!0}),history.replaceState(null,"",
`#${address}`),await navigator.clipboard?.writeText(location.href).then(()=>say("The link is copied."),()=>null))}
var nameOf2,init_link=__esm({"needlefit/viewer/page/link.js"(){init_address();init_dom();init_inputs();init_steering();
init_store();nameOf2=({name,scene})=>name??scene.measured?.id??scene.title;press("copy-link",copy)}});function define(name,called=name){if(!(name in DEFINITIONS))return called;let term=element("button",{type:"but\
ton",className:"term"},called);term.setAttribute("aria-description",DEFINITIONS[name]),term.tabIndex=-1;let show3=()=>{
let{left,top,bottom}=term.getBoundingClientRect();shown2.textContent=DEFINITIONS[name],shown2.style.left=`${Math.
max(8,Math.min(left,innerWidth-296))}px`;let above=top>ROOM3;shown2.style.bottom=above?`${innerHeight-top+6}px`:
"auto",shown2.style.top=above?"auto":`${bottom+6}px`,shown2.matches(":popover-open")||shown2.showPopover()},hide=()=>shown2.
matches(":popover-open")&&shown2.hidePopover();for(let kind of["pointerenter","focus","click"])term.addEventListener(
kind,show3);for(let kind of["pointerleave","blur"])term.addEventListener(kind,hide);return term}var DEFINITIONS,
ROOM3,shown2,init_definitions=__esm({"needlefit/viewer/page/definitions.js"(){init_dom();init_store();DEFINITIONS=
{depth:"Inserted arc length: how much of the needle is beyond the entry.","tip y":"Distance of the tip from th\
e entry axis, y; positive to the left of the entry.","tip slope":"Angle of the needle at its tip against the e\
ntry axis.","tip force":"Lateral force on the tip, as it stood at its last constraint point; between these poi\
nts it rises and falls. In space forces are magnitudes.","base force":"Lateral force that holds the base.","ba\
se moment":"Moment that holds the base.","steepest slope":"Largest slope dy/dx of the needle; the model takes \
it for small.",bevel:"Side, or roll, to which the bevel turns the cut.",roll:"Roll of the bevel from here on, \
about x: 0 turns the cut toward +y, 90 toward +z, ±180 toward −y.","tip z":"Distance of the tip from the pl\
ane of the entry axis and y.","base y":"Lateral displacement of the base of the needle, as it is set; positive\
 to the left.","base slope":"Angle of the base of the needle against the entry axis, as it is set.",guides:"Gu\
ides that hold the needle.",guide:"Where a guide holds the needle: x along the entry, y to its left, slope dy/\
dx as an angle.","noise floor":"The mean error that perfect parameters would still show if measurements err as\
 stated."};listen("scene",({definitions,shape_parameters:shapes})=>{Object.assign(DEFINITIONS,definitions);for(let{
symbol,explanation}of shapes)DEFINITIONS[symbol]=`${explanation[0].toUpperCase()}${explanation.slice(1)}.`});ROOM3=
110,shown2=element("div",{id:"definition",role:"tooltip",popover:"auto"});(part("explorer")??document.body).append(
shown2)}});function fillReadouts(list,readouts){let numbers=readouts.map(([name,unit])=>{let number=element("span",{},"–");
return list.append(entry(define(name),[number," ",element("small",{},unit)])),number});return from=>readouts.forEach(
([,,read],i)=>write(numbers[i],from?read(from):"–"))}function refresh(){let{state,scene}=now;writeNeedle(state),
part("readouts").children[TIP_Z].hidden=!state.z;let title=part("title");if(title&&write(title,`${isSteered(state,
scene)?"steered by hand: ":""}${scene.title}`),!scene.measured)return;let prediction=predictionOf(state,scene);
writeErrors(prediction?{...state.errors,...prediction.errors}:state.errors),write("against",`${prediction?"pre\
diction ":""}against ${scene.measured.id}${state.errors?`, ${comparedUpTo(state.errors)}`:""}`)}function inWords(){
let{state,scene}=now;if(!state)return"The needle has not been drawn yet.";let{tip,bevel,base,guides:guides2,errors}=state,
held=guides2.length===1?"1 guide":`${guides2.length} guides`,{symbol,value,digits:digits2,unit}=strengthOf(bevel),
sentences=[`The needle is ${state.depth_mm.toFixed(1)} mm deep, of ${scene.length_mm.toFixed(0)} mm.`,`Its tip\
 is ${Math.abs(tip.lateral_mm).toFixed(2)} mm to the ${tip.lateral_mm<0?"right":"left"}${tip.held?" and held t\
here":""}, at ${angle(tip)}${tip.z===null?"":`; z ${signed(tip.z,2)} mm`}.`,`The bevel turns the cut toward ${describeRoll(
bevel)}, ${symbol} is ${value.toFixed(digits2)} ${unit}.`,`The base stands at y ${signed(base.y,2)} mm, at ${angle(
base)}; ${held}.`,`Tip force ${load2(tipForce()??0,2)} N, base force ${load2(state.forces.base_n,2)} N.`];if(exceeded(
state)&&sentences.push(`The needle is ${exceeded(state)}.`),errors){let prediction=predictionOf(state,scene);sentences.
push(`${prediction?"The prediction against":"Against"} the measured needle ${comparedUpTo(errors)}: ${listErrors(
prediction?.errors??errors,scene.measured).join(", ")}.`)}return sentences.join(" ")}var load2,NEEDLE,TIP_Z,writeNeedle,
writeErrors,comparedUpTo,announced,exceeded,angle,refreshDescription,describe,init_readouts=__esm({"needlefit/\
viewer/page/readouts.js"(){init_definitions();init_dom();init_quantities();init_store();init_view();load2=(value,digits2)=>now.
state.z?value.toFixed(digits2):signed(value,digits2),NEEDLE=[["depth","mm",s=>s.depth_mm.toFixed(2)],["tip y",
"mm",s=>signed(s.tip.lateral_mm,2)],["tip z","mm",s=>s.z?signed(s.tip.z,2):"–"],["tip slope","°",s=>signed(
toDegrees(s.tip.rotation),2)],["tip force","N",()=>tipForce()===null?"–":load2(tipForce(),3)],["base force",
"N",s=>load2(s.forces.base_n,3)],["base moment","N mm",s=>load2(s.forces.base_nmm,1)],["steepest slope","",s=>s.
max_slope.toFixed(3)]],TIP_Z=NEEDLE.findIndex(([name])=>name==="tip z");writeNeedle=fillReadouts(part("readout\
s"),NEEDLE),writeErrors=_errors=>{};comparedUpTo=({whole,upto_mm:upto})=>whole?"over the whole insertion":`ove\
r the first ${upto.toFixed(1)} mm`;listen("scene",({measured:measured2})=>{if(part("compared").hidden=measured2===
null,!measured2)return;let metrics=measured2.metrics.map(([name,label2,unit,text])=>(DEFINITIONS[label2]=text,
[label2,unit,errors=>writeError(errors[name],unit)]));part("errors").replaceChildren(),writeErrors=fillReadouts(
part("errors"),[...metrics,["noise floor","mm",e=>e.floor_mm?.toFixed(3)??"–"]])});announced=!1,exceeded=({faults})=>faults?.
length?`outside the model: ${faults.join("; ")}`:"";listen("scene",()=>announced=!1);for(let kind of["forces",
"state"])listen(kind,()=>{now.state&&(refresh(),refreshDescription())});listen("state",state=>{let words=exceeded(
state);write("beyond",words&&`${words[0].toUpperCase()}${words.slice(1)}. Shape and forces cannot be relied on\
.`),part("beyond").classList.toggle("low",toPy(state.tip.y)<view.box.top+view.box.height/2),!(announced||!words)&&
(announced=!0,say(`The needle is ${words}.`))});angle=({rotation})=>`${signed(toDegrees(rotation),1)} degrees`;
refreshDescription=()=>write("described",inWords()),describe=()=>say(inWords())}});function paint2(name,colour2){if(colour2==="transparent")return`${name}="none"`;let[,hex,alpha]=colour2.match(
/^(#\w{6})(\w\w)?$/)??[];if(hex)return`${name}="${hex}"${alpha?` ${name}-opacity="${round(parseInt(alpha,16)/255)}\
"`:""}`;let parts=colour2.match(/[\d.]+/g)??[];return`${name}="#${parts.slice(0,3).map(one=>Number(one).toString(
16).padStart(2,"0")).join("")}"`}var BASELINES,escape,round,SvgContext,init_svg=__esm({"needlefit/viewer/page/\
svg.js"(){BASELINES={alphabetic:0,middle:.35,top:.8},escape=text=>text.replace(/[&<>"]/g,one=>`&#${one.charCodeAt(
0)};`),round=value=>Number(value.toFixed(3));SvgContext=class{fillStyle="#000000";strokeStyle="#000000";lineWidth=1;globalAlpha=1;lineCap="\
butt";lineJoin="miter";font="12px sans-serif";textAlign="left";textBaseline="alphabetic";#parts=[];#path=[];#dash=[];#matrix=new DOMMatrix;#stack=[];#clips=0;#halo="";#measure=document.
createElement("canvas").getContext("2d");write([width,height],wide,title,words){return`<svg xmlns="http://www.\
w3.org/2000/svg" ${`width="${wide}mm" height="${round(wide*height/width)}mm" viewBox="0 0 ${round(width)} ${round(
height)}"`} font-family="Liberation Sans, Arial, sans-serif">
<title>${escape(title)}</title>
<desc>${escape(words)}</desc>
${this.#parts.join(`
`)}
</svg>
`}#add(name,attributes,content=""){let{a,b,c,d,e,f}=this.#matrix,turned2=this.#matrix.isIdentity?"":` transfor\
m="matrix(${[a,b,c,d,e,f].map(round)})"`,opacity=this.globalAlpha<1?` opacity="${round(this.globalAlpha)}"`:"";
this.#parts.push(`<${name} ${attributes}${opacity}${turned2}${content?`>${content}</${name}>`:"/>"}`)}#line(){
let dash=this.#dash.length?` stroke-dasharray="${this.#dash.join(" ")}"`:"";return`${paint2("stroke",this.strokeStyle)}\
 stroke-width="${this.lineWidth}" stroke-linecap="${this.lineCap}" stroke-linejoin="${this.lineJoin}"${dash}`}save(){
let{fillStyle,strokeStyle,lineWidth,globalAlpha,lineCap,lineJoin,font,textAlign,textBaseline}=this;this.#stack.
push([{fillStyle,strokeStyle,lineWidth,globalAlpha,lineCap,lineJoin,font,textAlign,textBaseline},this.#matrix,
this.#dash,0])}restore(){let[values,matrix,dash,clips]=this.#stack.pop();for(let n=0;n<clips;n+=1)this.#parts.
push("</g>");Object.assign(this,values),[this.#matrix,this.#dash]=[matrix,dash]}clip(){this.#clips+=1,this.#parts.
push(`<clipPath id="clip-${this.#clips}"><path d="${this.#path.join("")}"/></clipPath>`,`<g clip-path="url(#cl\
ip-${this.#clips})">`),this.#stack.at(-1)[3]+=1}translate(x,y){this.#matrix=this.#matrix.translate(x,y)}rotate(angle2){
this.#matrix=this.#matrix.rotate(angle2*180/Math.PI)}setLineDash(dash){this.#dash=dash}beginPath(){this.#path=
[]}moveTo(x,y){this.#path.push(`M${round(x)} ${round(y)}`)}lineTo(x,y){this.#path.push(`${this.#path.length?"L":
"M"}${round(x)} ${round(y)}`)}closePath(){this.#path.push("Z")}rect(x,y,width,height){this.#path.push(`M${round(
x)} ${round(y)}h${round(width)}v${round(height)}h${round(-width)}Z`)}arc(x,y,radius){this.ellipse(x,y,radius,radius)}ellipse(x,y,along,across){
let half=to=>`A${round(along)} ${round(across)} 0 0 1 ${round(x+to*along)} ${round(y)}`;this.#path.push(`M${round(
x+along)} ${round(y)}${half(-1)}${half(1)}Z`)}roundRect(x,y,width,height,r){let turn2=(dx,dy)=>`a${r} ${r} 0 0\
 1 ${dx} ${dy}`;this.#path.push(`M${round(x+r)} ${round(y)}h${round(width-2*r)}${turn2(r,r)}v${round(height-2*
r)}${turn2(-r,r)}h${round(2*r-width)}${turn2(-r,-r)}v${round(2*r-height)}${turn2(r,-r)}Z`)}fill(){this.#add("p\
ath",`d="${this.#path.join("")}" ${paint2("fill",this.fillStyle)}`)}stroke(){this.#add("path",`d="${this.#path.
join("")}" fill="none" ${this.#line()}`)}fillRect(x,y,width,height){this.#add("rect",`x="${round(x)}" y="${round(
y)}" width="${round(width)}" height="${round(height)}" ${paint2("fill",this.fillStyle)}`)}strokeRect(x,y,width,height){
this.#add("rect",`x="${round(x)}" y="${round(y)}" width="${round(width)}" height="${round(height)}" fill="none\
" ${this.#line()}`)}measureText(text){return this.#measure.font=this.font,this.#measure.measureText(text)}strokeText(){
this.#halo=` ${paint2("stroke",this.strokeStyle)} stroke-width="${this.lineWidth}" stroke-linejoin="round" pai\
nt-order="stroke"`}fillText(text,x,y){let[,weight="",size3]=this.font.match(/^(\d+ )?([\d.]+)px/),anchor={left:"\
start",center:"middle",right:"end"}[this.textAlign],heavy=weight&&` font-weight="${weight.trim()}"`,below=BASELINES[this.
textBaseline]*Number(size3);this.#add("text",`x="${round(x)}" y="${round(y)}" dy="${round(below)}" font-size="${size3}\
"${heavy} text-anchor="${anchor}" ${paint2("fill",this.fillStyle)}${this.#halo}`,escape(text)),this.#halo=""}}}});function draw2(wide,begin2){let{box:box2,scale}=view,[whole,tall]=size(),width=wide*PX_PER_MM,share=(width-(whole-
box2.width))/box2.width,figure=[width,tall-box2.height+share*box2.height];Object.assign(view,{scale:scale*share,
box:{...box2,width:share*box2.width,height:share*box2.height}}),onPaper(!0);try{paintAll(begin2(figure),figure)}finally{
Object.assign(view,{scale,box:box2}),onPaper(!1)}return figure}function onPaper(on){usePaper(on),readPalette()}
function drawSvg(wide){let context3=new SvgContext,figure=draw2(wide,()=>context3);return new Blob([context3.write(
figure,wide,now.scene.title,inWords())],{type:"image/svg+xml"})}function drawPng(wide){let canvas4=document.createElement(
"canvas");return draw2(wide,figure=>{let times=DPI/96;Object.assign(canvas4,{width:Math.round(times*figure[0]),
height:Math.round(times*figure[1])});let context3=canvas4.getContext("2d");return context3.scale(times,times),
context3}),new Promise(resolve=>canvas4.toBlob(resolve,"image/png"))}var PX_PER_MM,DPI,init_figure=__esm({"nee\
dlefit/viewer/page/figure.js"(){init_dom();init_drawing();init_link();init_strokes();init_readouts();init_store();
init_svg();init_view();PX_PER_MM=96/25.4,DPI=300;press("save-figure",async()=>{if(!now.state)return;let format=part(
"figure-format").value,figure=await(format==="svg"?drawSvg:drawPng)(Number(part("figure-width").value)),name=`${nameOf2(
now.needle).replace(/[^\w-]+/g,"-")}.${format}`;hand(figure,name),write("link-note",`Saved ${name}: the pictur\
e as it is shown.`),invalidate()});for(let[kind,on]of[["beforeprint",!0],["afterprint",!1]])addEventListener(kind,
()=>{onPaper(on),touch(),now.state&&paintScreen()})}});function going(what){let at=performance.now(),gesture=what===lastMove.what&&at-lastMove.at<WITHIN?lastMove.gesture:
newGesture();return lastMove={what,at,gesture},{gesture}}function insert2(mm){let{step:{depth},scene}=now.steered,
end=Math.max(Math.min(now.steered.reach(),scene.limits.depth_mm),depth);change([["depth_mm",null,Math.min(Math.
max(depth+mm,0),end)]],going("insert"))}function addGuide(){let[item,x]=[freeNumber(),freePlace()];change([["g\
uide_x_mm",item,x],["guide_y_mm",item,heightAt(now.state,x)],["guide_turns_freely",item,1]])}function freeNumber(){
let taken=now.state.guides.map(({item:item2})=>item2),item=now.scene.guide_names.length+1;for(;taken.includes(
item);)item+=1;return item}function freePlace(){let taken=now.state.guides.map(({x})=>x).filter(x=>x<0),edges=[
Math.max(now.state.base.x+BASE_CLEAR,CLEAR2-REACH*now.scene.length_mm),...taken,-CLEAR2].sort((one,other)=>one-
other),gaps=edges.slice(1).map((edge,i)=>[edge-edges[i],(edge+edges[i])/2]);return Math.round(gaps.reduce((widest,gap)=>gap[0]>
widest[0]?gap:widest)[1]*10)/10}var WITHIN,CLEAR2,BASE_CLEAR,REACH,lastMove,flip,roll,moveBase,toggleTip,init_actions=__esm(
{"needlefit/viewer/page/actions.js"(){init_inputs();init_quantities();init_steering();init_store();WITHIN=1e3,
CLEAR2=2,BASE_CLEAR=5,REACH=.6,lastMove={what:"",at:-1/0,gesture:0};flip=()=>change([turnOver(now.state.bevel.
roll_deg)]),roll=by=>change([["bevel_roll_deg",null,wrap(now.state.bevel.roll_deg+by)]],going("roll")),moveBase=
mm=>change([["base_y_mm",null,now.state.base.input_y+mm]],going("base"));toggleTip=()=>change([["tip_held",null,
now.state.tip.held?0:1]])}});function makeField(into,about){let part2=template.content.firstElementChild.cloneNode(!0),[number,slider,mark3,
back]=[".number",".slider",".mark",".home"].map(one=>part2.querySelector(one)),[to,from]=about.logarithmic?LOGARITHMIC:
LINEAR,[low,high]=(about.limits??[0,1]).map(to),field={read:Number,step:1,...about,part:part2,number,slider,mark:mark3,
back,value:null,latest:0,text:"",home:null,editing:!1,gesture:newGesture(),share:value=>Math.min(Math.max((to(
value)-low)/(high-low),0),1),at:share=>from(low+share*(high-low))},{of,name,symbol,unit,limits}=about;made+=1,
number.id=`field-${made}`;let term=define(symbol,name);symbol&&number.setAttribute("aria-description",DEFINITIONS[symbol]),
part2.querySelector(".name").append(term),part2.querySelector(".unit").textContent=unit,number.ariaLabel=slider.
ariaLabel=[of,name].filter(Boolean).join(" ")+(unit&&`, ${unit}`),slider.max=STEPS,back.ariaLabel=`${number.ariaLabel}\
: back to its initial value`,limits||part2.querySelector(".track").remove(),wireNumber(field);let goHome2=()=>{
field.gesture=newGesture(),field.home!==null&&ask(field,field.home)};return slider.addEventListener("input",()=>ask(
field,field.at(slider.value/STEPS))),slider.addEventListener("change",()=>field.gesture=newGesture()),slider.addEventListener(
"keydown",event=>event.key in SLIDES&&stepBy(field,SLIDES[event.key],event)),press(back,goHome2),setHome(field,
null),into.append(part2),field}function show2(field,value){if(value===field.value)return;field.value=field.latest=
value;let text=field.text=field.write(value);!field.editing&&field.number.value!==text&&(field.number.value=text),
field.slider.value=Math.round(STEPS*field.share(value)),field.slider.ariaValueText=`${text} ${field.unit}`.trim(),
markHome(field)}function setHome(field,home){field.home=home,field.back.hidden=field.mark.hidden=home===null,home!==
null&&(field.mark.style.left=`calc(${THUMB/2}px + ${field.share(home)} * (100% - ${THUMB}px))`,field.back.title=
`back to ${field.write(home)} ${field.unit}`.trim(),markHome(field))}function markHome({part:part2,back,write:write2,
value,home}){back.disabled=home===null||value===null||write2(home)===write2(value),part2.querySelector(".hand").
hidden=back.disabled}function ask(field,value){field.latest=value,field.value=null,field.ask(value,{gesture:field.
gesture,below:field.part})}function wireNumber(field){let{number}=field;number.addEventListener("input",()=>field.
editing=!0),number.addEventListener("blur",()=>giveBack(field)),number.addEventListener("change",()=>{if(field.
gesture=newGesture(),field.editing=!1,number.value!=="")return ask(field,field.read(number.value));publish("no\
tice",{what:`No ${number.ariaLabel}: ${field.text} is kept.`,expected:"a number"}),giveBack(field)}),number.addEventListener(
"keydown",event=>{event.key in ARROWS&&stepBy(field,ARROWS[event.key],event),event.key==="Escape"&&giveBack(field)}),
number.addEventListener("keyup",({key})=>{key==="Enter"&&(field.editing=!1)})}function giveBack(field){field.editing=
!1,field.value!==null&&(field.number.value=field.text)}function stepBy(field,direction,event){event.preventDefault();
let{number,step,logarithmic}=field,from=field.editing&&number.value!==""?field.read(number.value):field.latest;
field.editing=!1,event.repeat||(field.gesture=newGesture()),ask(field,logarithmic?from*step**direction:from+step*
direction)}var template,STEPS,THUMB,LINEAR,LOGARITHMIC,ARROWS,SLIDES,made,init_fields=__esm({"needlefit/viewer\
/page/fields.js"(){init_definitions();init_dom();init_steering();init_store();template=part("field-template"),
STEPS=1e3,THUMB=16,LINEAR=[x=>x,x=>x],LOGARITHMIC=[x=>Math.log(Math.max(x,Number.MIN_VALUE)),Math.exp],ARROWS=
{ArrowUp:1,ArrowDown:-1},SLIDES={...ARROWS,ArrowRight:1,ArrowLeft:-1,PageUp:10,PageDown:-10},made=0}});var listParameters,init_parameters=__esm({"needlefit/viewer/page/parameters.js"(){init_quantities();listParameters=
({layer_names:names,limits,fitted:fitted2,shape_parameters:shapes})=>fitted2.layers.flatMap((layer,i)=>{let called=names[i]||
`layer ${i+1}`,modulus2={...modulusLike(layer.mu_pa),name:`μ ${called}`,symbol:"μ",logarithmic:!0,step:1.05,
limits:limits.mu_pa};return[{input:"mu_pa",item:i+1,into:"tissue-fields",about:modulus2},...shapes.map(({name,
symbol,unit})=>{let step=Math.min(.1,(limits[name][1]-limits[name][0])/100),about={name:`${symbol} ${called}`,
symbol,unit,step,write:value=>value.toFixed(2),limits:limits[name]};return{input:name,item:i+1,into:"shape-fie\
lds",about}})]})}});function buildFields({scene,recording}){fields=[],guides.clear();for(let id of["insertion-fields","tissue-fiel\
ds","shape-fields","guides"])part(id).replaceChildren();let add2=(into,[input,item],about,current2,{shown:shown3=x=>x,
meant=x=>x}={})=>{let field=makeField(part(into),{...about,ask:(value,how)=>change([[input,item,meant(value)]],
how)}),home=recording&&into==="insertion-fields"?void 0:current2(scene.fitted);home!==void 0&&setHome(field,shown3(
home)),fields.push([field,()=>shown3(current2(now.state))])},{limits,fitted:fitted2,simulation}=scene,mm={unit:"\
mm",step:.1};add2("insertion-fields",["depth_mm",null],{...mm,name:"depth",symbol:"depth",step:1,write:digits(
1),limits:[0,limits.depth_mm-.01]},of=>of.depth_mm??scene.depth_mm),add2("insertion-fields",["base_y_mm",null],
{...mm,name:"base y",symbol:"base y",write:digits(2),limits:[-10,10]},of=>of.base?of.base.input_y:simulation.steps[0].
controls.baseY),add2("insertion-fields",["base_slope",null],{name:"base slope",symbol:"base slope",unit:"°",step:.1,
write:digits(2),limits:[-5,5]},of=>of.base?of.base.input_slope:simulation.steps[0].controls.baseSlope,{shown:degrees,
meant:slope}),add2("insertion-fields",["bevel_roll_deg",null],ROLL_FIELD,of=>(of.bevel??{roll_deg:rollOf(simulation.
steps[0].bevel)}).roll_deg);let{key,symbol,unit,digits:count,step,here,throughout}=strengthOf(fitted2);recording?.
some(([,changes])=>changes.some(([name])=>name===here))||add2("tissue-fields",[throughout,null],{name:symbol,symbol,
unit,step,write:digits(count),limits:limits[key]},of=>(of.bevel??of)[key]),part("shape-part").hidden=!simulation.
law.terms||!scene.shape_parameters.length;for(let{input,item,into,about}of listParameters(scene))(simulation.law.
terms||input==="mu_pa")&&add2(into,[input,item],about,of=>of.layers[item-1][input])}function refresh2(){for(let[
field,current2]of fields)show2(field,current2());part("side").textContent=describeRoll(now.state.bevel),part("\
hold-tip").textContent=now.state.tip.held?"Let go of the tip":"Hold the tip";for(let[item,row]of guides)now.state.
guides.some(guide=>guide.item===item)||(row.part.remove(),guides.delete(item));for(let guide of now.state.guides)
refreshGuide(guide)}function makeGuide({item,name:called=numbered(item)}){let row=part("guide-template").content.
firstElementChild.cloneNode(!0),[free,remove,into]=[".free",".remove",".fields"].map(one=>row.querySelector(one));
row.querySelector("strong").textContent=called,remove.ariaLabel=`Remove ${called}`,free.ariaLabel=`Needle turn\
s freely in ${called}`;let field=(name,unit,count,input,meant=x=>x)=>makeField(into,{of:called,name,symbol:"gu\
ide",unit,step:.1,write:digits(count),ask:(value,how)=>change([[input,item,meant(value)]],how)});return press(
remove,()=>{change([["guide_engaged",item,0]]),part("add-guide").focus()}),press(free,()=>change([["guide_turn\
s_freely",item,free.ariaPressed==="true"?0:1]])),part("guides").append(row),{part:row,free,x:field("x","mm",2,
"guide_x_mm"),y:field("y","mm",3,"guide_y_mm"),slope:field("slope","°",2,"guide_slope",slope)}}function refreshGuide({
item,name,x,y,slope:along,turns_freely:free}){guides.has(item)||guides.set(item,makeGuide({item,name}));let row=guides.
get(item);show2(row.x,x),show2(row.y,y),show2(row.slope,degrees(along??0)),row.slope.part.hidden=free,row.free.
ariaPressed=String(free)}var digits,guides,fields,init_inputs2=__esm({"needlefit/viewer/page/inputs.js"(){init_actions();
init_dom();init_fields();init_parameters();init_inputs();init_quantities();init_steering();init_store();digits=
count=>value=>value.toFixed(count),guides=new Map,fields=[];press("add-guide",()=>addGuide());press("hold-tip",
()=>toggleTip());for(let kind of["state","unchanged"])listen(kind,refresh2)}});function current(){let{step,depth_mm:depth,depths,x,y,tip,tip_path:[,across]}=now.state;return{step,depth,x,y,
path:{x:[...depths,depth],y:[...across,tip.y]},forces:now.forces}}function draw3(){if(part("strip").hidden||!now.
state)return;let[width,height]=size2;canvas2.width!==Math.round(width*devicePixelRatio)&&(canvas2.width=Math.round(
width*devicePixelRatio)),canvas2.height!==Math.round(height*devicePixelRatio)&&(canvas2.height=Math.round(height*
devicePixelRatio)),context2.setTransform(devicePixelRatio,0,0,devicePixelRatio,0,0),context2.clearRect(0,0,width,
height);let deep=greatest();PANELS.forEach((panel,n)=>{let[left,right]=[n*width/2+PAD.left,(n+1)*width/2-PAD.right];
drawPanel(panel,deep,{left,right,top:PAD.top,bottom:height-PAD.bottom})}),describe2(deep)}function drawPanel([
name,unit,digits2,curveOf],deep,{left,right,top,bottom}){let curves=needles().map(([one,colour2])=>[one,curveOf(
one),colour2]),values=curves.flatMap(([,{y}])=>y),[low,high]=[Math.min(0,...values),Math.max(0,...values)],px=depth=>left+
depth/deep*(right-left),py=y=>bottom-(y-low)/(high-low||1)*(bottom-top);segments(context2,[[[left,py(0)],[right,
py(0)]],[[left,top],[left,bottom]]],palette.quiet,1);for(let[,{x,y},colour2]of curves)trace(context2,x.map((one,i)=>[
px(one),py(y[i])])),stroke(context2,colour2,2);let at=now.marked??now.state.depth_mm;segments(context2,[[[px(at),
top],[px(at),bottom]]],now.marked===null?palette.quiet:palette.accent,1),context2.fillStyle=palette.label,setFont(
context2,"small","left");let read=`${name}, ${unit}`;for(let[one,curve,colour2]of curves.toReversed()){let value=valueAt(
[one,curve],at);Number.isNaN(value)||(ring(context2,px(Math.min(at,curve.x.at(-1))),py(value),3,colour2,palette.
air),now.marked!==null&&(read+=`${one===now.pinned?", pinned":":"} ${signed(value,digits2)}`))}context2.fillStyle=
palette.label,context2.fillText(read,left,top-10),setFont(context2,"small","right");let ends=high-low<10**-digits2?
[[0,py(0)]]:[[low,bottom],[high,top]];for(let[value,place2]of ends)context2.fillText(String(Number(value.toFixed(
digits2))||0).replace("-","−"),left-4,place2);context2.textBaseline="alphabetic",context2.fillText(`depth ${brief(
now.marked??deep,3)} mm`,now.marked===null?right:Math.min(px(at)+30,right),bottom+13),context2.textAlign="left",
context2.fillText("0",left,bottom+13)}function describe2(deep){let at=now.marked??now.state.depth_mm,read=one=>PANELS.
map(([name,unit,digits2,curve])=>{let value=valueAt([one,curve(one)],at);return`${name} ${Number.isNaN(value)?
"–":`${signed(value,digits2)} ${unit}`}`}).join(", "),words=needles().map(([one])=>`${one===now.pinned?"pinn\
ed: ":""}${read(one)}`).reverse().join("; ");Object.assign(canvas2,{ariaValueNow:at.toFixed(1),ariaValueMax:deep.
toFixed(1),ariaValueText:`At ${at.toFixed(1)} mm: ${words}`})}function mark2(depth){now.marked=depth===null?null:
Math.max(0,Math.min(depth,greatest())),invalidate(),draw3()}function under({clientX}){let{left,width}=canvas2.
getBoundingClientRect();return((clientX-left)%(width/2)-PAD.left)/(width/2-PAD.left-PAD.right)*greatest()}function pin(){
now.pinned=now.pinned?null:current(),part("pin").ariaPressed=String(now.pinned!==null),part("pin").textContent=
now.pinned?"Unpin":"Pin",publish("pinned"),invalidate(),draw3()}var PAD,canvas2,context2,size2,PANELS,needles,
greatest,valueAt,go,KEYS,init_strip=__esm({"needlefit/viewer/page/strip.js"(){init_dom();init_drawing();init_strokes();
init_quantities();init_store();PAD={left:46,right:12,top:18,bottom:16},canvas2=element("canvas",{id:"strip-can\
vas",tabIndex:0,role:"slider",ariaLabel:"Depth to read at",ariaValueMin:"0",ariaValueMax:"1",ariaValueNow:"0",
title:"Tip against depth. Arrow keys or pointer mark a depth, Enter or a click goes there."});part("strip").append(
canvas2);context2=canvas2.getContext("2d"),size2=[1,1],PANELS=[["tip y","mm",2,({path})=>path],["tip force","N",
2,({forces})=>forces]];needles=()=>[[now.pinned,palette.ghost],[current(),palette.needle]].filter(([one])=>one);
greatest=()=>Math.max(now.scene.depth_mm,...needles().map(([{depth}])=>depth),1),valueAt=([one,curve],at)=>at<=
one.depth+1e-9&&curve.x.length?heightAt(curve,at):NaN;go=()=>now.marked!==null&&publish("go to",now.marked),KEYS=
{ArrowRight:()=>mark2((now.marked??now.state.depth_mm)+1),ArrowLeft:()=>mark2((now.marked??now.state.depth_mm)-
1),Home:()=>mark2(0),End:()=>mark2(greatest()),Enter:go,Escape:()=>mark2(null)};canvas2.addEventListener("keyd\
own",event=>{!(event.key in KEYS)||!now.state||(event.preventDefault(),event.stopPropagation(),KEYS[event.key]())});
canvas2.addEventListener("pointermove",event=>now.state&&mark2(under(event)));for(let kind of["pointerleave","\
blur"])canvas2.addEventListener(kind,()=>now.state&&mark2(null));press(canvas2,event=>now.state&&(mark2(under(
event)),go()));press("pin",()=>now.state&&pin());listen("scene",()=>[now.forces,now.marked]=[{x:[],y:[]},null]);
listen("state",draw3);listen("forces",forces=>{now.pinned?.step===forces.step&&(now.pinned.forces=forces),draw3()});
new ResizeObserver(()=>{size2=[canvas2.clientWidth,canvas2.clientHeight],draw3()}).observe(canvas2);onScheme(()=>requestAnimationFrame(
draw3))}});function hear(event){if(!now.state||event.altKey)return;let key=event.key.length===1?event.key.toLowerCase():event.
key,act=event.ctrlKey||event.metaKey?COMMANDS[key]:KEYS2.find(([keys])=>keys.includes(key))?.[3];act&&(event.preventDefault(),
act(event))}var KEYS2,COMMANDS,init_keyboard=__esm({"needlefit/viewer/page/keyboard.js"(){init_actions();init_dom();
init_quantities();init_readouts();init_steering();init_store();init_strip();init_view();KEYS2=[[["ArrowRight"],
"→","insert 1 mm; with Shift 0.1 mm",e=>insert2(e.shiftKey?.1:1)],[["ArrowLeft"],"←","retract, likewise",e=>insert2(
e.shiftKey?-.1:-1)],[["ArrowUp"],"↑","base up by 0.1 mm; with Shift by 1 mm",e=>moveBase(e.shiftKey?1:.1)],[
["ArrowDown"],"↓","base down, likewise",e=>moveBase(e.shiftKey?-1:-.1)],[["f"],"F","flip the bevel",()=>flip()],
[["r"],"R",`roll the bevel by ${ROLL}°; with Shift back`,e=>roll(e.shiftKey?-ROLL:ROLL)],[["g"],"G","add a gu\
ide",()=>addGuide()],[["t"],"T","hold the tip, let go of it",()=>toggleTip()],[["k"],"K","pin this needle to c\
ompare with, or unpin",()=>pin()],[["d"],"D","say where the needle stands",()=>describe()],[["+","="],"+","zoo\
m in",()=>zoom(1.25)],[["-","_"],"−","zoom out",()=>zoom(.8)],[["0","1"],"0, 1","show the whole needle",()=>fit(
"whole")],[["2"],"2","show the tissue",()=>fit("tissue")],[["3"],"3","follow the tip",()=>fit("tip")]],COMMANDS=
{z:event=>event.shiftKey?redo():undo(),y:()=>redo()};for(let[written3,what]of[...KEYS2.map(([,key,effect])=>[key,
effect]),["Ctrl+Z, Y","undo, redo"]])part("key-list").append(entry(element("kbd",{},written3),what));part("can\
vas").addEventListener("keydown",hear);press("undo",undo);press("redo",redo);press("flip",flip)}});function makeRow(method,row){if(!method.x)return row(method.name,errorsOf(method.errors));let swatch=element("\
i",{className:"swatch line",ariaHidden:"true"});swatch.style.background=`light-dark(${method.colour}, ${lighten(
method.colour)})`;let toggle2=element("button",{type:"button",ariaPressed:String(chosen.has(method.key))},swatch,
method.name);return press(toggle2,()=>{let on=chosen.has(method.key);on?chosen.delete(method.key):chosen.add(method.
key),toggle2.ariaPressed=String(!on),invalidate()}),row(toggle2,errorsOf(method.errors))}var JUDGED,chosen,FITTED,
own,present,errorsOf,lighten,init_methods=__esm({"needlefit/viewer/page/methods.js"(){init_dom();init_drawing();
init_strokes();init_quantities();init_store();JUDGED="prediction",chosen=new Set,FITTED="fitted",own=new Map,present=
[],errorsOf=values=>now.scene.measured.metrics.map(([name,,unit])=>writeError(values?.[name]??null,unit)),lighten=
colour2=>between(colour2,"#ffffff",.4);listen("scene",({measured:measured2})=>{let{methods}=now.needle;if(part(
"methods").hidden=!methods,!methods)return;let heads=["method",...measured2.metrics.map(([,label2,unit])=>`${label2}\
 (${unit})`)];part("method-heads").replaceChildren(...heads.map(one=>element("th",{scope:"col"},one)));let row=(name,values)=>element(
"tr",{},element("th",{scope:"row"},name),values.map(one=>element("td",{},one))),first=row("",errorsOf(null));present=
[...first.cells],own.clear();let rows=methods.toSorted((one,other)=>+(other.key===JUDGED)-+(one.key===JUDGED)).
map(method=>{let made2=makeRow(method,row);return[JUDGED,FITTED].includes(method.key)&&own.set(method.key,made2),
made2});part("method-rows").replaceChildren(first,...rows)});listen("state",state=>{if(!now.needle.methods)return;
let{errors}=state,upto=errors&&!errors.whole?`, first ${errors.upto_mm.toFixed(1)} mm`:"",prediction=predictionOf(
state,now.scene),steered=isSteered(state,now.scene)||Math.abs(state.depth_mm-now.scene.depth_mm)>1e-6,known=now.
needle.methods.find(({key})=>key===(prediction?JUDGED:FITTED)),called=steered?`steered needle${upto}`:known?.name??
"the needle above";own.forEach((row,key)=>row.hidden=!steered||key===FITTED&&own.has(JUDGED)),[called,...errorsOf(
prediction?.errors??errors)].forEach((text,i)=>write(present[i],text))});further.push(context3=>{for(let{key,x,
y,colour:colour2}of now.needle?.methods??[])!x||!chosen.has(key)||(line(context3,x,y,palette.halo,4),line(context3,
x,y,isDark()?lighten(colour2):colour2,2))})}});function down(event){if(event.button>0)return;canvas3.setPointerCapture(event.pointerId);let at=place(event);if(fingers.
set(event.pointerId,at),fingers.size>1)drag=null;else{let handle=handleAt(...at,event.pointerType);handle&&(drag=
{handle,from:at,last:at,to:at,gesture:newGesture(),pointer:event.pointerId})}canvas3.classList.toggle("draggin\
g",drag!==null),hold(drag!==null)}function follow2(event){if(drag?.pointer!==event.pointerId||!now.state)return;
let at=place(event);drag.to=drag.to.map((to,i)=>to+(event.shiftKey?FINE:1)*(at[i]-drag.last[i])),drag.last=at;
let set=drag.handle.drag(drag.from,drag.to);set.length&&change(set,{gesture:drag.gesture})}function moved(event){
let before2=fingers.get(event.pointerId);if(!before2)return hover(event);if(drag)return RAW?void 0:follow2(event);
let at=place(event);fingers.size===1?pan(at[0]-before2[0],at[1]-before2[1]):fingers.size===2&&pinch(event.pointerId,
before2,at),fingers.set(event.pointerId,at)}function pinch(id,before2,at){let other=[...fingers].find(([finger])=>finger!==
id)[1],distance2=([x,y])=>Math.max(Math.hypot(x-other[0],y-other[1]),20);pan((at[0]-before2[0])/2,(at[1]-before2[1])/
2),zoom(distance2(at)/distance2(before2),(at[0]+other[0])/2,(at[1]+other[1])/2)}function up(event){drag?.pointer===
event.pointerId&&(event.type==="pointerup"&&follow2(event),drag=null),fingers.delete(event.pointerId),canvas3.
classList.remove("dragging"),hold(!1)}function hover(event){let cursor=handleAt(...place(event))?.cursor??"";canvas3.
style.cursor!==cursor&&(canvas3.style.cursor=cursor)}function wheel(event){!event.ctrlKey&&!event.metaKey||(event.
preventDefault(),zoom(Math.exp(-.2*(event.deltaY||event.deltaX)/NOTCH[event.deltaMode]),...place(event)))}var NOTCH,
FINE,canvas3,fingers,drag,place,RAW,HEARD,init_pointers=__esm({"needlefit/viewer/page/pointers.js"(){init_dom();
init_handles();init_steering();init_store();init_view();NOTCH={0:100,1:3,2:1},FINE=.1,canvas3=part("canvas"),fingers=
new Map,drag=null,place=event=>{let{left,top}=canvas3.getBoundingClientRect();return[event.clientX-left,event.
clientY-top]};RAW="onpointerrawupdate"in canvas3,HEARD={pointerdown:down,pointermove:moved,pointerrawupdate:follow2,
pointerup:up,pointercancel:up};for(let[kind,hear2]of Object.entries(HEARD))canvas3.addEventListener(kind,hear2);
canvas3.addEventListener("wheel",wheel,{passive:!1})}});function goBack(){write("link-note",""),part("back").disabled=!0,now.replay?showStep(now.replay.steps.length):
goHome()}function showStep(n,clock=timeOf(n)){let{replay}=now;forgetPast(),replay.to(n),part("scrub").value=n===
replay.steps.length?part("scrub").max:clock,part("scrub").ariaValueText=`${clock.toFixed(1)} s`,write("time",`${clock.
toFixed(1)} s of ${timeOf(replay.steps.length).toFixed(1)} s`),show()}function play(on){if(part("play").textContent=
on?"Pause":"Play",!on)return void(playing=null);let{replay}=now,n=replay.at===replay.steps.length||replay.changed?
0:replay.at;playing={clock:timeOf(n),last:performance.now(),n},requestAnimationFrame(advance)}function advance(t){
if(!playing)return;let{steps:steps2}=now.replay,ends=Math.max(timeOf(steps2.length),1e-9);for(playing.clock+=(t-
playing.last)/1e3*(ends/Math.min(Math.max(ends,SHORTEST2),LONGEST)),playing.last=t;playing.n<steps2.length&&timeOf(
playing.n+1)<=playing.clock;)playing.n+=1;if(showStep(playing.n,Math.min(playing.clock,ends)),playing.n===steps2.
length)return play(!1);requestAnimationFrame(advance)}function openRecording(recording){now.replay=recording?new Replay(
now.steered,recording):null,part("transport").hidden=!recording,recording&&(part("scrub").max=Math.ceil(10*(recording.
at(-1)?.[0]??0))/10)}function readRecording(text){let lines=text.split(/\r?\n/),count=lines.findIndex(one=>!one.
startsWith("#")),number=now.data.needles.findIndex(({head})=>head&&identify(head)===identify(text));if(count<1||
lines[count]!==COLUMNS)throw new ModelError("the file is no recording","a file of Save recording, or of needle\
fit plan");if(number<0)throw new ModelError("the recording is of another scene","one of this page; needlefit v\
iew --recording opens others");let steps2=[];for(let row of lines.slice(count+1).filter(Boolean)){let[step,time,
name,item,value,tip]=row.split(",");Number(step)>steps2.length&&steps2.push([Number(time),[],NaN]);let last2=steps2.
at(-1);last2[1].push([name,item?Number(item):null,Number(value)]),tip&&(last2[2]=Number(tip))}return{number,steps:steps2}}
function openDropped(choose2){addEventListener("dragover",event=>event.preventDefault()),addEventListener("dro\
p",async event=>{event.preventDefault();let[file]=event.dataTransfer?.files??[];if(file)try{let{number,steps:steps2}=readRecording(
await file.text());await choose2(number),openRecording(steps2),goBack(),write("link-note",`Opened ${file.name}\
.`)}catch(error){refuse(error,part("proof").parentElement)}})}function keep(){let{needle,steered}=now,text=JSON.
stringify({head:needle.head,way:steered.listWay().map(({changes})=>changes)});try{text.length<=MOST_KEPT&&localStorage.
setItem(keyOf(needle),text)}catch{}}function restore(){let{needle,steered,replay}=now,kept=JSON.parse(localStorage.
getItem(keyOf(needle))??"null");if(!kept||kept.head!==needle.head)return!1;steered.rewind();try{for(let changes of kept.
way)steered.apply(changes,{validOnly:!1})}catch{return localStorage.removeItem(keyOf(needle)),goBack(),!1}return replay&&
(replay.changed=!0),part("back").disabled=!1,write("link-note","The needle as you left it: this browser keeps \
it."),show(),!0}var SHORTEST2,LONGEST,PAUSE,MOST_KEPT,COLUMNS,playing,timeOf,identify,keyOf,keeping,init_recording=__esm(
{"needlefit/viewer/page/recording.js"(){init_address();init_dom();init_link();init_inputs();init_steering();init_store();
init_stored();[SHORTEST2,LONGEST]=[2,20],PAUSE=400,MOST_KEPT=1e6,COLUMNS="step,time_s,input,item,value,tip_lat\
eral_mm",playing=null,timeOf=n=>n?now.replay.steps[n-1][0]:0;part("scrub").addEventListener("input",({target})=>{
play(!1);let{steps:steps2}=now.replay,clock=Math.min(Number(target.value),timeOf(steps2.length));showStep(steps2.
filter(([time])=>time<=clock).length,clock)});press("play",()=>play(!playing));press("back",()=>{localStorage.
removeItem(keyOf(now.needle)),goBack()});listen("steers",()=>{now.replay&&(play(!1),now.replay.changed=!0)});press(
"save-recording",()=>{let name=`${nameOf2(now.needle).replace(/[^\w-]+/g,"-")}.csv`;hand(new Blob([writeRecording(
now.needle.head,now.steered)],{type:"text/csv"}),name),write("link-note",`Saved ${name}. It opens on this page\
, and with: needlefit view --recording ${name}`)});identify=head=>head.split(`
`).filter(one=>one.startsWith("#")).slice(1).filter(one=>!one.startsWith("# needlefit =")).join(`
`);keyOf=needle=>`needlefit ${location.pathname} ${nameOf2(needle)}`,keeping=0;listen("steers",()=>{clearTimeout(
keeping),keeping=setTimeout(keep,PAUSE)});addEventListener("pagehide",()=>keeping&&keep())}});function listTurned(depth,{simulation:{steps:[first]},depth_mm:deepest2}){return[ANEW2,[["depth_mm",null,depth]],
[turnOver(rollOf(first.bevel))],[["depth_mm",null,deepest2]]]}function listAway({session:{shape:{x,u}}}){let first=x.
findIndex(one=>one>=0),slope2=(u[x.length-1]-u[first])/(x[x.length-1]-x[first]);return[...x.keys()].slice(first).
map(i=>u[i]-u[first]-slope2*(x[i]-x[first]))}function findTurn(needle){let{scene}=needle,{steps:[first,...rest]}=scene.
simulation,inputs=({bevel,controls})=>JSON.stringify([bevel,controls]);if(rest.some(one=>inputs(one)!==inputs(
first)))return null;let makesS=depth=>{for(let changes of listTurned(depth,scene))needle.apply(changes,always3);
let away=listAway(needle);return Math.min(Math.max(...away),-Math.min(...away))>(scene.measured?.floor_mm??NOISE)};
return TURNS.map(one=>Math.round(one*scene.depth_mm)).find(makesS)??null}function findLayerForces(x,loads,{boundaries_mm:tops,
spacing_mm:spacing}){let planes=loads.map(one=>smooth(x,one,spacing)),forces=Array.from({length:tops.length+1},
()=>0);for(let i=1;i<x.length;i+=1){let[one,other]=[i-1,i].map(at=>Math.hypot(...planes.map(plane=>plane[at]))),
middle=(x[i]+x[i-1])/2;forces[tops.filter(top=>top<=middle).length]+=(one+other)/2*(x[i]-x[i-1])}return forces}
function findStiffer(needle){let{scene}=needle,{fitted:{layers},limits:{mu_pa:limits},boundaries_mm:tops,depth_mm:deepest2}=scene,
read=()=>{let{s,loads}=needle.session.forces();return findLayerForces([...s],loads.map(one=>[...one]),scene)},
before2=read(),entered=1+tops.filter(top=>top<deepest2).length;if(entered<2||!needle.valid)return null;let best=layers.
slice(0,entered).map(({mu_pa:from},i)=>{let to=Math.min(from*STIFFER,limits[1]);needle.apply([["mu_pa",i+1,to]],
always3);let[after,{valid}]=[read(),needle];return needle.apply([["mu_pa",i+1,from]],always3),{valid,layer:i+1,
from,to,before:before2,moved:Math.abs(after[i]-before2[i]),all:add(after)}}).filter(({valid})=>valid).toSorted(
(one,other)=>other.moved-one.moved)[0];return best&&best.moved>=MOVED*best.all?best:null}var ANEW2,TURNS,NOISE,
STIFFER,MOVED,always3,add,init_probes=__esm({"needlefit/viewer/page/model/probes.js"(){init_quantities();init_inputs();
ANEW2=[["return_to",null,0]],TURNS=[.5,.6,.4,.7,.3,.2],NOISE=.1,STIFFER=10,MOVED=.05,always3={validOnly:!1};add=
values=>values.reduce((sum,one)=>sum+one,0)}});function toggle(name,on=chips[name].ariaPressed!=="true"){chips[name].ariaPressed=String(on),name==="strip"&&(part(
"strip").hidden=!on),shown[name]=on,invalidate()}var CHIPS,TALL,fits,chips,offer,init_toolbar=__esm({"needlefi\
t/viewer/page/toolbar.js"(){init_dom();init_drawing();init_store();init_view();CHIPS=[["load","lateral load"],
["points","constraint points"],["path","tip path"],["measured","measured"],["errors","errors","Gaps at the tip\
 (TE) and along the shaft (IPE)"],["band","95 % band","95 % of the needles lie wholly inside"],["plan","plan"],
["pinned","pinned"],["strip","tip against depth","Deflection of the tip and tip force, against depth",!1]],TALL=
800,fits=document.querySelectorAll("[data-fit]"),chips=Object.fromEntries(CHIPS.map(([name,called,title="",marked=!0])=>{
let swatch=marked?[element("i",{ariaHidden:"true",className:`swatch ${name}`})]:[],pressed=String(shown[name]??
!1),chip=button([...swatch,called],()=>toggle(name),{title,ariaPressed:pressed});return chip.dataset.show=name,
[name,chip]}));part("chips").append(...Object.values(chips));offer=there=>Object.entries(there).forEach(([name,
is])=>chips[name].hidden=!is);offer({measured:!1,errors:!1,band:!1,plan:!1,pinned:!1});innerHeight<TALL&&toggle(
"strip");for(let one of fits)press(one,()=>fit(one.dataset.fit));for(let[way,factor]of[["in",1.25],["out",.8]])
press(document.querySelector(`[data-zoom=${way}]`),()=>zoom(factor));listen("scene",({measured:measured2,draws,
plan})=>offer({measured:measured2,errors:measured2,band:draws,plan}));listen("pinned",()=>offer({pinned:now.pinned}));
listen("redraw",()=>fits.forEach(one=>one.ariaPressed=String(one.dataset.fit===view.fit)))}});function prepareTurn(needle){let{scene}=needle,from=findTurn(needle);return from===null?null:{sentence:`Turn t\
he bevel at ${from} mm: the needle makes an S.`,see:()=>"Behind the turn the needle bends to the other side. D\
otted: without the turn. Move it.",begin(into){let turn2=depth=>{marks=[{depth,text:"turn"}],steer(listTurned(
depth,scene)),show2(field,depth)},limits=BETWEEN.map(one=>one*scene.depth_mm),field=makeField(into,{name:"turn\
 at depth",unit:"mm",write:value=>value.toFixed(1),limits,ask:turn2});turn2(from)}}}function prepareStiffer(needle){
let best=findStiffer(needle);if(!best)return null;let{scene}=needle,{limits:{mu_pa:limits},layer_names:names,boundaries_mm:tops,
depth_mm:deepest2}=scene,{layer,from,to,before:before2}=best,called=names[layer-1]||`layer ${layer}`,ends=[...tops,
1/0],middle=((layer>1?tops[layer-2]:0)+Math.min(ends[layer-1],deepest2))/2,readShown=()=>findLayerForces(now.state.
load.x,now.state.load.n_per_mm,scene);return{sentence:`Stiffen ${called}: where does the force go?`,see:()=>{if(now.
state.faults.length)return marks=[],"The needle is outside the limits of the model: its forces are not shown.";
let after=readShown();return marks=[{depth:middle,text:`${after[layer-1].toFixed(1)} N here`}],`Lateral force \
of ${called}: ${before2[layer-1].toFixed(1)} to ${after[layer-1].toFixed(1)} N (100 g weigh 1 N). Purple: the \
load, where it acts. Dotted: the needle before.`},begin(into){toggle("load",!0);let stiffen=value=>{steer([[["\
mu_pa",layer,value]]]),show2(field,value)},about={...modulusLike(to),name:`μ ${called}`,symbol:"μ",logarithmic:!0,
step:1.05},field=makeField(into,{...about,limits,ask:stiffen});stiffen(to)}}}async function prepareScenes(kernel,scene){
let needle=await SteeredNeedle.begin(kernel,scene),prepare=one=>{try{for(let changes of[ANEW2,...listSteps(scene)])
needle.apply(changes,{validOnly:!1});return one(needle)}catch(error){if(!error.expected)throw error;return null}};
return[prepareTurn,prepareStiffer].map(prepare).filter(one=>one)}function offerScenes(kernel){let[begin2,shown3]=[
null,null],list=part("scene-list"),leave=()=>{[begin2,shown3,marks]=[null,null,[]],part("scene-control").replaceChildren(),
write("see","")},choose2=(scene,pressed)=>{for(let one of list.querySelectorAll("button"))one.ariaPressed=String(
one===pressed);leave(),begin2=()=>{now.pinned&&pin(),pin(),shown3=scene,scene.begin(part("scene-control"))},steer(
[ANEW2,...listSteps(now.scene)])};listen("scene",async given=>{leave(),list.replaceChildren();let scenes=await prepareScenes(
kernel,given);now.scene===given&&list.replaceChildren(...scenes.map(scene=>{let pressed=button(scene.sentence,
()=>now.state&&choose2(scene,pressed),{ariaPressed:"false"});return element("li",{},pressed)}))}),listen("stat\
e",()=>shown3&&write("see",shown3.see())),listen("forces",({step})=>{if(step!==now.state.step||!begin2)return;
let then=begin2;begin2=null,then()})}var BETWEEN,marks,init_scenes=__esm({"needlefit/viewer/page/scenes.js"(){
init_dom();init_drawing();init_fields();init_inputs();init_probes();init_steered();init_strokes();init_quantities();
init_steering();init_store();init_strip();init_toolbar();init_view();BETWEEN=[.1,.9],marks=[];further.push(context3=>{
for(let{depth,text}of marks){let[px,py]=[toPx(depth),toPy(heightAt(now.state,depth))];segments(context3,[[[px,
py-12],[px,py+12]]],palette.accent,2),ring(context3,px,py,4,palette.accent,palette.air),setFont(context3,"stro\
ng"),labelFree(context3,text,[[px,py-26],[px,py+26],[px+40,py-26],[px-40,py+26]],palette.accent)}})}});var main_exports={};async function choose(number){let{data}=now;part("needle-choice").value=number;let steered=await begin(
data.kernel,data.needles[number]);if(Number(part("needle-choice").value)!==number)return;let needle=data.needles[number];
Object.assign(now,{needle,steered});let{scene}=needle;openRecording(needle.recording),take({...scene,kind:"sce\
ne"}),buildFields(needle);let specimen=needle.new_specimen?" of a specimen that was not fitted":"",draws=counted(
scene.draws?.sets??0,"posterior draw");write("band-note",scene.draws?`Band: holds 95 % of the needles of ${draws}${specimen}\
 wholly, without noise and model error.`:""),part("origin-mark")&&write("origin-mark",scene.origin_mark),goBack()}
async function stateAgreement(){let{data}=now,{count,largest}=await prove(data,SAME3),[what,of]=data.needles[0].
recording?["recorded state","recording"]:["needle",data.title?"report":"program"],[agrees,place2]=[largest<SAME3,
part("proof")],found=largest===0?`the same bytes as in the ${of}`:`up to ${largest.toExponential(1)} mm from t\
he ${of}`;place2.className=`quiet ${agrees?"good":"bad"}`,place2.dataset.count=count,place2.dataset.largest=largest;
let checked=`Self-check ${agrees?"passed":"failed"}: ${counted(count,what)} computed here`;write("proof",`${checked}\
, ${Number.isNaN(largest)?"one without a result":found} (needlefit ${data.needlefit}).`)}async function start(){
let data=now.data=await load(),script=new Blob([part("program").textContent],{type:"text/javascript"});computeBands(
new Worker(URL.createObjectURL(script)),data.kernel,()=>({name:data.needles.indexOf(now.needle),steered:now.steered}));
let choice=part("needle-choice");choice.append(...data.needles.map((one,i)=>element("option",{value:String(i)},
[nameOf2(one),one.group].filter(Boolean).join(", ")))),part("choosing").hidden=data.needles.length<2,choice.addEventListener(
"change",()=>choose(Number(choice.value))),part("canvas").addEventListener("touchstart",event=>{handleAt(...place(
event.touches[0]),"touch")&&event.preventDefault()},{passive:!1}),addEventListener("hashchange",()=>followAddress(
choose)),openDropped(choose),offerScenes(data.kernel),listen("go to",depth=>change([["depth_mm",null,depth]]));
for(let name of["load","points","path","errors","strip"])toggle(name,!1);await choose(0);let led=await followAddress(
choose)||restore();fit("tissue"),await stateAgreement(),!led&&now.replay&&!now.scene.plan&&!matchMedia("(prefe\
rs-reduced-motion: reduce)").matches&&play(!0)}var NEEDED,init_main=__esm({"needlefit/viewer/page/main.js"(){init_above();
init_address();init_bands();init_dom();init_figure();init_handles();init_inputs2();init_keyboard();init_link();
init_methods();init_pointers();init_quantities();init_recording();init_scenes();init_steering();init_store();init_stored();
init_toolbar();init_view();NEEDED=["WebAssembly","DecompressionStream","Worker"];start().catch(error=>{let lacking=NEEDED.
filter(name=>!(name in globalThis));throw write("proof",lacking.length?`This browser lacks ${lacking.join(", ")}\
: it cannot compute the needle.`:`The needle was not computed, for a fault in this file: ${error.message}`),part(
"proof").classList.add("bad"),error})}});typeof document>"u"?Promise.resolve().then(()=>(init_band_worker(),band_worker_exports)):Promise.resolve().then(()=>(init_main(),main_exports));})();
